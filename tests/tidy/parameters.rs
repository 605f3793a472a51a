//! Parameters of functions: a tuple counts as its members.

use super::Finding;
use super::code::functions;
use super::tree::{SourceFile, Tree};

/// Most values that a function may take, `self` left out; clippy allows as many parameters.
const VALUES_MAX: usize = 7;

/// Most values that a stage may take to record its commands, `self` left out.
const STAGE_VALUES_MAX: usize = 5;

pub fn tuples_hide_no_parameters(tree: &Tree) -> Vec<Finding> {
    let too_many = |_: &SourceFile, _: &str, values: &[usize]| {
        values.iter().any(|&count| count > 1) && values.iter().sum::<usize>() > VALUES_MAX
    };
    functions_of(tree, too_many)
}

pub fn stages_take_few_values(tree: &Tree) -> Vec<Finding> {
    let too_many = |file: &SourceFile, function: &str, values: &[usize]| {
        file.path.starts_with("engine/render/src/stages/")
            && ["fn record(", "fn record<"]
                .iter()
                .any(|start| function.starts_with(start))
            && values.iter().sum::<usize>() > STAGE_VALUES_MAX
    };
    functions_of(tree, too_many)
}

/// The functions whose code and numbers of values by parameter `is_wrong`.
fn functions_of(
    tree: &Tree,
    is_wrong: impl Fn(&SourceFile, &str, &[usize]) -> bool,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        for (line, function) in functions(&file.code) {
            let Some(parameters) = parameters(function) else {
                continue;
            };
            let values: Vec<usize> = pieces(parameters).into_iter().filter_map(values).collect();
            if is_wrong(file, function, &values) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line,
                    what: format!(
                        "a function of {} values, members of tuples counted",
                        values.iter().sum::<usize>()
                    ),
                });
            }
        }
    }
    findings
}

/// Text between the parentheses of the function that `code` begins with.
fn parameters(code: &str) -> Option<&str> {
    let mut generics = 0_usize;
    let open = code.char_indices().find_map(|(at, c)| {
        match c {
            '<' => generics += 1,
            // An arrow closes nothing.
            '>' if !code[..at].ends_with('-') => generics = generics.saturating_sub(1),
            _ => {}
        }
        (c == '(' && generics == 0).then_some(at)
    })?;
    let mut depth = 0_usize;
    let close = code[open..].char_indices().find_map(|(at, c)| {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        (depth == 0).then_some(open + at)
    })?;
    Some(&code[open + 1..close])
}

/// `list` split at its own commas.
fn pieces(list: &str) -> Vec<&str> {
    let (mut found, mut depth, mut start) = (Vec::new(), 0_usize, 0);
    for (at, c) in list.char_indices() {
        match c {
            '(' | '[' | '{' | '<' => depth += 1,
            ')' | ']' | '}' => depth = depth.saturating_sub(1),
            '>' if !list[..at].ends_with('-') => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                found.push(&list[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    found.push(&list[start..]);
    found.retain(|piece| !piece.trim().is_empty());
    found
}

/// Values that `parameter` holds; none for `self`.
fn values(parameter: &str) -> Option<usize> {
    // Types begin behind the colon that no other one follows or precedes; patterns have none.
    let (_, declared) = parameter.split_once(": ")?;
    let declared = declared.trim().trim_start_matches('&').trim();
    let members = declared
        .strip_prefix('(')
        .and_then(|rest| rest.strip_suffix(')'));
    Some(members.map_or(1, |members| pieces(members).len().max(1)))
}
