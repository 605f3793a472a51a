//! Outputs survive a power cut: what a file holds is on the disk before it gets its name, and the
//! name is on the disk before the program ends. Told by the calls that the program makes.

use super::*;

/// One call that made something durable or gave it a name.
#[derive(Debug, PartialEq)]
enum Call<'a> {
    /// The content of a file, or the names in a folder, by path.
    Synced(&'a str),
    /// A file that had the first path has the second now.
    Named(&'a str, &'a str),
}

/// The call in a line of strace with paths of descriptors (`-y`), if it worked and tells something.
fn call(line: &str) -> Option<Call<'_>> {
    let (_, call) = line.split_once(' ')?;
    let call = call.trim_start();
    if !call.trim_end().ends_with("= 0") {
        return None;
    }
    let quoted: Vec<&str> = call.split('"').skip(1).step_by(2).collect();
    match (call.split('(').next()?, &quoted[..]) {
        ("fsync" | "fdatasync", _) => {
            let (_, path) = call.split_once('<')?;
            Some(Call::Synced(path.rsplit_once('>')?.0))
        }
        ("rename" | "renameat" | "renameat2" | "linkat", [from, to]) => Some(Call::Named(from, to)),
        _ => None,
    }
}

/// Files that got a name in a trace, in order.
///
/// # Errors
/// A file that got its name before it was on the disk, or whose name never was.
fn durable(trace: &str) -> Result<Vec<&str>, String> {
    let calls: Vec<Call<'_>> = trace.lines().filter_map(call).collect();
    let mut named = Vec::new();
    for (index, one) in calls.iter().enumerate() {
        let Call::Named(from, to) = one else {
            continue;
        };
        // A file without a name is linked by its descriptor, and synced as the number of its node.
        let is_content = |path: &str| match from.starts_with("/proc/self/fd/") {
            true => path.contains("/#"),
            false => path == *from,
        };
        let last_name = calls[..index]
            .iter()
            .rposition(|call| matches!(call, Call::Named(..)));
        let since = &calls[last_name.map_or(0, |last| last + 1)..index];
        let mut synced = since.iter();
        let is_synced = synced.any(|call| matches!(call, Call::Synced(path) if is_content(path)));
        // A file that replaces another has a name of its own first.
        if !is_synced && !named.contains(from) {
            return Err(format!(
                "{to} has its name before its content is on the disk"
            ));
        }
        let folder = Path::new(to).parent().unwrap();
        let is_folder = |path: &str| Path::new(path) == folder;
        if !calls[index..]
            .iter()
            .any(|call| matches!(call, Call::Synced(path) if is_folder(path)))
        {
            return Err(format!("the name of {to} never reaches the disk"));
        }
        named.push(*to);
    }
    Ok(named)
}

/// The calls of a run of the program that matter; `None`, with a word of it, where they cannot be
/// watched.
fn traced(folder: &Path, arguments: &[&str]) -> Option<String> {
    let trace = folder.join("trace.txt");
    let watched = "trace=fsync,fdatasync,rename,renameat,renameat2,linkat";
    let watch = Command::new("strace")
        .args(["-f", "-y", "-s", "4096", "-e", watched, "-o"])
        .arg(&trace)
        .arg(env!("CARGO_BIN_EXE_decouplegs"))
        .args(arguments)
        .output();
    let said = match &watch {
        Ok(output) if output.status.success() => return fs::read_to_string(&trace).ok(),
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    println!("NOT CHECKED: strace cannot watch the program: {said}");
    None
}

#[test]
fn outputs_are_on_the_disk_before_they_have_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().canonicalize().unwrap();
    let cone = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../engine/asset/fuzz/seeds/inria_ply/cone.ply"
    );
    let splats = folder.join("cone.spz");
    // The second run replaces what the first one wrote.
    for _ in 0..2 {
        let Some(trace) = traced(&folder, &["convert", cone, text(&splats), "--force"]) else {
            return;
        };
        let named = durable(&trace).unwrap();
        assert_eq!(named.last(), Some(&text(&splats)), "{trace}");
    }
    let out = folder.join("run");
    let drive = ["drive", "--level", "easy", "--episodes", "1", "--render"];
    let drive = [&drive[..], &["off", "--planner", "constant-velocity"]].concat();
    let trace = traced(&folder, &[&drive[..], &["--out", text(&out)]].concat()).unwrap();
    let named = durable(&trace).unwrap();
    let log = out.join("logs/easy_0000.log");
    assert!(named.contains(&text(&log)), "{trace}");
    assert!(named.contains(&text(&out.join("report.json"))), "{trace}");
}

#[test]
fn names_without_content_are_seen() {
    let synced = "7 fsync(5</out/#12>(deleted)) = 0\n";
    let linked = "7 linkat(AT_FDCWD, \"/proc/self/fd/5\", AT_FDCWD, \"/out/cone.spz\", AT_SYMLINK_FOLLOW) = 0\n";
    let folder = "7 fsync(5</out>) = 0\n";
    let whole = [synced, linked, folder].concat();
    assert_eq!(durable(&whole), Ok(vec!["/out/cone.spz"]));
    let late = [linked, synced, folder].concat();
    assert!(durable(&late).unwrap_err().contains("before its content"));
    let never = [synced, linked].concat();
    assert!(durable(&never).unwrap_err().contains("never reaches"));
    let failed = whole.replacen("= 0", "= -1 EIO (Input/output error)", 1);
    assert!(durable(&failed).is_err());
    let part =
        "7 fdatasync(4</out/a.log.part>) = 0\n7 rename(\"/out/a.log.part\", \"/out/a.log\") = 0\n";
    assert_eq!(durable(&[part, folder].concat()), Ok(vec!["/out/a.log"]));
    let other = part.replacen("a.log.part", "b.log.part", 1);
    assert!(durable(&[&other, folder].concat()).is_err());
}
