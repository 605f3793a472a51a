//! The rules. Words that a rule forbids are put together from halves here, so that this file keeps
//! the rules too.

use super::Rule;
use super::checks::{
    crates_depend_one_way, crates_forbid_unsafe, files_have_an_end, functions_fit_a_screen,
    kernel_has_its_stem, named_for_a_subject, no_function_is_called_of, no_machine_paths,
    nothing_undone, shader_says_what_it_is, unsafe_is_explained, unsafe_only_in_gpu,
    vulkan_only_in_gpu,
};
use super::claims::{claims_name_their_tests, named_tests_exist};
use super::modules::{every_file_is_a_module_of_another, modules_do_not_use_each_other};
use super::parameters::{stages_take_few_values, tuples_hide_no_parameters};
use super::words::{
    a_scene_is_the_sessions, comments_are_narrow, docs_name_their_subject, docs_say_something,
    no_retired_words,
};

/// Every rule.
pub const RULES: &[Rule] = &[
    Rule {
        name: "every Rust file is compiled: another declares it as its module, or a Cargo.toml names it",
        check: every_file_is_a_module_of_another,
        kept_by: &[
            ("engine/a/src/lib.rs", "mod b;"),
            ("engine/a/src/b.rs", "mod c;"),
            ("engine/a/src/b/c.rs", ""),
            ("tests/main.rs", "mod d;"),
            ("tests/d/mod.rs", ""),
        ],
        broken_by: &[
            ("engine/a/src/e.rs", ""),
            ("tests/e/mod.rs", ""),
            ("tests/d/c.rs", ""),
        ],
    },
    Rule {
        name: "nothing is left undone: finish it, or write an issue",
        check: nothing_undone,
        kept_by: &[(
            "engine/a.rs",
            "// A todo list is a list.\nlet unimplemented = 1;",
        )],
        broken_by: &[
            ("engine/a.rs", concat!("// TO", "DO: later")),
            ("shaders/a.comp", concat!("// FIX", "ME")),
            ("tools/a.rs", concat!("fn a() { unimpl", "emented!() }")),
            ("tests/a.rs", concat!("#[ign", "ore = \"slow\"]\nfn a() {}")),
        ],
    },
    Rule {
        name: "a file is named for its subject",
        check: named_for_a_subject,
        kept_by: &[("engine/gpu/src/memory.rs", "")],
        broken_by: &[
            ("engine/gpu/src/utils.rs", ""),
            ("engine/scene/src/common/pose.rs", ""),
            ("tools/resource_manager.rs", ""),
            ("shaders/include/helpers.glsl", ""),
        ],
    },
    Rule {
        name: "unsafe code stays in engine/gpu, and at the boundaries to C and Python",
        check: unsafe_only_in_gpu,
        kept_by: &[
            (
                "engine/gpu/src/a.rs",
                "// SAFETY: checked above.\nunsafe { a() }",
            ),
            (
                "tools/python/src/a.rs",
                "// SAFETY: checked above.\nunsafe { a() }",
            ),
            (
                "tools/main.rs",
                "#![forbid(unsafe_code)]\n// unsafe in a comment\nlet a = \"unsafe\";",
            ),
        ],
        broken_by: &[
            ("engine/render/src/a.rs", "fn a() { unsafe { b() } }"),
            ("tools/pythons.rs", "fn a() { unsafe { b() } }"),
        ],
    },
    Rule {
        name: "every unsafe block and impl says above it why it is sound, after 'SAFETY:'",
        check: unsafe_is_explained,
        kept_by: &[(
            "engine/gpu/src/a.rs",
            "// SAFETY: `b` outlives the call,\n// and nobody else has it.\nlet a =\n    unsafe { b() };\nunsafe fn c() {}",
        )],
        broken_by: &[
            ("engine/gpu/src/a.rs", "fn a() {\n    unsafe { b() };\n}"),
            (
                "engine/gpu/src/a.rs",
                "// SAFETY: this is about the first.\nlet a = 1;\nlet b = unsafe { c() };",
            ),
            (
                "engine/gpu/src/a.rs",
                "/// A thing.\nunsafe impl Send for A {}",
            ),
        ],
    },
    Rule {
        name: "Vulkan's types stay in engine/gpu",
        check: vulkan_only_in_gpu,
        kept_by: &[
            ("engine/gpu/src/a.rs", "use ash::vk;"),
            ("engine/render/src/a.rs", "// as vk::Buffer is to gpu"),
        ],
        broken_by: &[
            ("engine/render/src/a.rs", "fn a(buffer: vk::Buffer) {}"),
            ("tools/a.rs", "use ash::Entry;"),
        ],
    },
    Rule {
        name: "a shader says in its first line, behind #version, what it is",
        check: shader_says_what_it_is,
        kept_by: &[
            ("shaders/include/a.glsl", "// The constants.\n"),
            ("shaders/b.comp", "#version 460\n// Adds.\n"),
        ],
        broken_by: &[
            (
                "shaders/a.comp",
                "#version 460\nlayout(local_size_x = 64) in;\n// Adds.\n",
            ),
            ("shaders/b.glsl", ""),
        ],
    },
    Rule {
        name: "a kernel shares its stem with its stage, its twin and their test",
        check: kernel_has_its_stem,
        kept_by: &[
            ("shaders/a.comp", "// A"),
            ("engine/render/src/stages/a.rs", ""),
            ("engine/render/src/twins/a.rs", ""),
            ("tests/stages/a.rs", ""),
            ("shaders/include/b.glsl", "// B"),
        ],
        broken_by: &[("shaders/a.comp", "// A")],
    },
    Rule {
        name: "crates depend one way: tools on the engine, render on gpu, asset and render on scene",
        check: crates_depend_one_way,
        kept_by: &[
            (
                "engine/render/Cargo.toml",
                "[dependencies]\ndecouplegs-gpu.workspace = true\n",
            ),
            (
                "tools/Cargo.toml",
                "name = \"decouplegs-tools\"\ndecouplegs-render.workspace = true\n",
            ),
            (
                "engine/drive/Cargo.toml",
                "[dev-dependencies]\ndecouplegs-asset.workspace = true\n",
            ),
        ],
        broken_by: &[
            (
                "engine/asset/Cargo.toml",
                "[dependencies]\ndecouplegs-render.workspace = true\n",
            ),
            (
                "engine/drive/Cargo.toml",
                "[dependencies]\ndecouplegs-asset.workspace = true\n\n[dev-dependencies]\n",
            ),
            (
                "engine/gpu/Cargo.toml",
                "[dependencies]\ndecouplegs-scene = { path = \"../scene\" }\n",
            ),
            (
                "engine/scene/Cargo.toml",
                "[dev-dependencies]\ndecouplegs.workspace = true\n",
            ),
            (
                "tools/Cargo.toml",
                "[dependencies]\ndecouplegs-server.workspace = true\n\n[dev-dependencies]\n",
            ),
        ],
    },
    Rule {
        name: "every crate but engine/gpu and the boundaries to C and Python forbids unsafe code in its first file",
        check: crates_forbid_unsafe,
        kept_by: &[
            ("engine/a/src/lib.rs", "//! A.\n#![forbid(unsafe_code)]\n"),
            ("engine/gpu/src/lib.rs", ""),
            ("engine/gpu/tests/device/main.rs", ""),
            ("engine/drive/tests/main.rs", ""),
            ("tools/python/sharing/src/lib.rs", ""),
            ("engine/a/src/b.rs", ""),
        ],
        broken_by: &[
            ("engine/a/src/lib.rs", "// #![forbid(unsafe_code)]"),
            ("tools/main.rs", ""),
            ("benches/src/main.rs", ""),
            ("engine/lib.rs", ""),
        ],
    },
    Rule {
        name: "no path of one machine in what others read",
        check: no_machine_paths,
        kept_by: &[
            ("README.md", "a framework/root of the /temporary kind"),
            ("tests/a.rs", concat!("\"/t", "mp/x\"")),
        ],
        broken_by: &[
            ("README.md", concat!("see /wo", "rk/main")),
            ("tools/a.rs", concat!("let a = \"/t", "mp\";")),
            (".ci/run", concat!("cd /ro", "ot/a")),
            ("benches/README.md", concat!("in /ho", "me/someone")),
        ],
    },
    Rule {
        name: "a doc comment begins with a noun or a verb",
        check: docs_name_their_subject,
        kept_by: &[(
            "engine/a.rs",
            "/// Visible splats.\n/// What follows may begin so.\nfn a() {}\n\n/// The same image.\nfn b() {}\n",
        )],
        broken_by: &[
            ("engine/a.rs", "/// What culling finds.\nfn a() {}\n"),
            ("engine/a.rs", "//! How a world is stored.\n"),
            (
                "engine/a.rs",
                "/// Reads.\n///\n/// # Errors\n/// When it fails.\nfn a() {}\n",
            ),
            ("engine/a.rs", "/// And at most.\nconst A: u8 = 1;\n"),
            (
                "engine/a.rs",
                "/// The other's: the ego stood.\nconst A: u8 = 1;\n",
            ),
            ("engine/a.rs", "/// The same of agents.\nconst A: u8 = 1;\n"),
            ("engine/a.rs", "/// The same, rounded.\nconst A: u8 = 1;\n"),
            ("engine/a.rs", "/// ... and so far.\nconst A: u8 = 1;\n"),
        ],
    },
    Rule {
        name: "a comment has at most 100 columns",
        check: comments_are_narrow,
        kept_by: &[("engine/a.rs", "// short\nlet a = \"http://x\";\n")],
        broken_by: &[
            (
                "engine/a.rs",
                "// 23456789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 1\n",
            ),
            (
                "shaders/a.comp",
                "    // 789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 123456789 1\n",
            ),
        ],
    },
    Rule {
        name: "two modules of a crate do not use each other",
        check: modules_do_not_use_each_other,
        kept_by: &[
            ("engine/a/src/c.rs", "use crate::{b::D, e};"),
            ("engine/a/src/e.rs", "use crate::f::G;"),
            ("engine/a/src/b/tests.rs", "use crate::c::D;"),
            ("engine/a/src/f.rs", "use crate::{g::{c::D, h}, i};"),
            ("engine/a/src/h.rs", "use crate::f::G;"),
        ],
        broken_by: &[
            ("engine/a/src/b.rs", "use crate::c::E;"),
            ("engine/a/src/i.rs", "use crate::{j::{self, k::L}, f::M};"),
        ],
    },
    Rule {
        name: "on the way of a frame, one public type is called Scene: that of engine/session",
        check: a_scene_is_the_sessions,
        kept_by: &[
            ("engine/session/src/scene.rs", "pub struct Scene {}"),
            ("engine/asset/src/a.rs", "pub struct LoadedScene {}"),
            (
                "engine/render/src/a.rs",
                "/// A scene.\npub struct FrameSplats<'a> {}\nstruct Scene {}",
            ),
            ("engine/render/tests/a.rs", "pub struct Scene {}"),
        ],
        broken_by: &[
            ("engine/render/src/a.rs", "pub struct Scene<'a> {}"),
            ("engine/session/src/a.rs", "pub struct OtherScene {}"),
            ("tools/render.rs", "pub enum SceneState { A }"),
        ],
    },
    Rule {
        name: "retired words stay retired",
        check: no_retired_words,
        kept_by: &[
            ("CHANGELOG.md", concat!("the pict", "ures are images now\n")),
            ("engine/a.rs", "// An image in color.\n"),
        ],
        broken_by: &[
            ("engine/a.rs", concat!("// A pict", "ure.\n")),
            ("README.md", concat!("The col", "our of it.\n")),
            ("shaders/a.comp", concat!("uint fir", "sts;\n")),
            ("tools/a.rs", concat!("value_name = \"MET", "RES\"\n")),
            (
                "engine/a.rs",
                concat!("// It is looked\n    // a", "t twice.\n"),
            ),
        ],
    },
    Rule {
        name: "no function is called of",
        check: no_function_is_called_of,
        kept_by: &[
            (
                "engine/a.rs",
                "fn offset() {}\nfn of_agents() {}\n// fn of()\n",
            ),
            ("engine/b.rs", "let a = |of: u8| of;\n"),
        ],
        broken_by: &[
            ("engine/a.rs", concat!("pub fn o", "f(a: u8) -> Self {}\n")),
            ("tests/a.rs", concat!("fn o", "f<'a>(a: &'a u8) {}\n")),
        ],
    },
    Rule {
        name: "a function has at most 95 lines, in a test 160",
        check: functions_fit_a_screen,
        kept_by: &[(
            "engine/a.rs",
            "fn a() -> u32 {\n    { 1 }\n}\ntrait B { fn b(); }\n",
        )],
        broken_by: &[(
            "engine/a.rs",
            // 96 lines.
            "fn a() {\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n}\n",
        )],
    },
    Rule {
        name: "a function takes at most 7 values, the members of tuples counted",
        check: tuples_hide_no_parameters,
        kept_by: &[(
            "engine/a.rs",
            "fn a<F: Fn(u8) -> u8>(&self, b: (u8, u8), c: F, d: u8, e: [u8; 4], f: u8, g: u8) {}\n",
        )],
        broken_by: &[(
            "engine/a.rs",
            "fn a(b: (u8, u8), c: &(u8, Vec<(u8, u8)>), d: u8, e: u8, f: u8, g: u8) {}\n",
        )],
    },
    Rule {
        name: "a stage takes at most 5 values to record its commands",
        check: stages_take_few_values,
        kept_by: &[
            (
                "engine/render/src/stages/a.rs",
                "fn record(&self, r: &mut R, a: u8, b: (u8, u8), c: u8) {}\n",
            ),
            (
                "engine/render/src/a.rs",
                "fn record(a: u8, b: u8, c: u8, d: u8, e: u8, f: u8) {}\n",
            ),
        ],
        broken_by: &[
            (
                "engine/render/src/stages/a.rs",
                "fn record(&self, r: &mut R, a: u8, b: (u8, u8), c: u8, d: u8) {}\n",
            ),
            (
                "engine/render/src/stages/b/a.rs",
                "fn record(r: &mut R, a: u8, b: u8, c: u8, d: u8, e: u8) {}\n",
            ),
            (
                "engine/render/src/stages/c.rs",
                "fn record<'a>(&self, r: &mut R, a: &'a u8, b: u8, c: u8, d: u8, e: u8) {}\n",
            ),
        ],
    },
    Rule {
        name: "a doc comment has more than one word",
        check: docs_say_something,
        kept_by: &[(
            "engine/a.rs",
            "/// Width, pixels.\nfn a() {}\n/// Splats\n/// in all.\nfn b() {}\n",
        )],
        broken_by: &[
            ("engine/a.rs", "/// Who.\nfn a() {}\n"),
            ("engine/a.rs", "struct A {\n    /// Lanes.\n    b: u8,\n}\n"),
        ],
    },
    Rule {
        name: "a claim of checked, never or once names its test",
        check: claims_name_their_tests,
        kept_by: &[
            ("tests/a.rs", "#[test]\nfn a_b_c() {}\n"),
            (
                "README.md",
                "Never\nwrong (`a::a_b_c`).\n\n- Drawn once, `tests/a.rs`.\n- Fast.\n",
            ),
            ("engine/README.md", "```sh\nonce\n```\n"),
        ],
        broken_by: &[
            ("README.md", "- Never wrong.\n- `a_b_c`\n"),
            ("engine/README.md", "Checked by\n`tests/b.rs`.\n"),
        ],
    },
    Rule {
        name: "tests that documents name exist",
        check: named_tests_exist,
        kept_by: &[
            ("tests/a.rs", "#[test]\nfn a_b_c() {}\n"),
            ("benches/README.md", "`a::a_b_c`, `Options::a_b`, `a_b_c_d`"),
        ],
        broken_by: &[("benches/README.md", "By `a::a_b_d`.")],
    },
    Rule {
        name: "a file has at most 550 lines, in a test 600, and usually 300",
        check: files_have_an_end,
        kept_by: &[("engine/a.rs", "\n\n\n"), ("README.md", LINES_551)],
        broken_by: &[
            ("engine/a.rs", LINES_551),
            ("shaders/include/a.glsl", LINES_551),
        ],
    },
];

/// One line more than a file may have.
const LINES_551: &str = {
    const BYTES: [u8; 551] = [b'\n'; 551];
    match std::str::from_utf8(&BYTES) {
        Ok(text) => text,
        Err(_) => panic!("line feeds are text"),
    }
};
