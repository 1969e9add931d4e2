//! Tests of the imports in `src/`: a module imports only lower modules, and files have no import cycles.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Top-level modules, lowest first. `solve` and `metric` do not import each other.
const ROOMS: [&str; 8] = ["base", "engine", "solve", "metric", "files", "page", "lab", "cli"];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Adds all files of a folder under their module paths. `engine/stages/mod.rs` is `["engine", "stages"]`.
fn modules(folder: &Path, path: &[String], into: &mut BTreeMap<Vec<String>, PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let stem = entry.file_stem().unwrap().to_string_lossy().into_owned();
        let own = [path, std::slice::from_ref(&stem)].concat();
        if entry.is_dir() {
            modules(&entry, &own, into);
        } else if entry.extension().is_some_and(|e| e == "rs") {
            into.insert(if stem == "mod" { path.to_vec() } else { own }, entry);
        }
    }
}

/// Returns the text of a file without comments and tests.
fn code(file: &Path) -> String {
    let text = fs::read_to_string(file).unwrap();
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    code.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// Adds the leaves of a tree of imports, such as `a::{b, c::d}`.
fn leaves(prefix: &str, tree: &str, into: &mut Vec<String>) {
    let Some((head, body)) = tree.split_once('{') else {
        into.push(format!("{prefix}{}", tree.trim()));
        return;
    };
    let body = body.rsplit_once('}').map_or(body, |(body, _)| body);
    let (mut depth, mut start) = (0, 0);
    for (i, c) in body.char_indices().chain([(body.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                leaves(&format!("{prefix}{}", head.trim()), &body[start..i], into);
                start = i + 1;
            }
            _ => {}
        }
    }
}

/// Returns the module paths that a file imports or names with `crate::` or `super::`.
fn referenced(module: &[String], code: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    for (at, root) in code.match_indices("crate::").chain(code.match_indices("super::")) {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = &code[at..];
        let is_use = code[..at].trim_end().ends_with("use");
        let end = if is_use {
            rest.find(';').unwrap()
        } else {
            rest.find(|c: char| !c.is_alphanumeric() && c != '_' && c != ':').unwrap_or(rest.len())
        };
        let mut imported = Vec::new();
        leaves("", &rest[..end], &mut imported);
        for leaf in imported {
            let mut path = if root == "crate::" { Vec::new() } else { module.to_vec() };
            for part in leaf.split("::").map(|part| part.split_whitespace().next().unwrap_or("")) {
                match part {
                    "crate" => {}
                    // `super` removes the last name of the module path, both for a file and for a folder's mod.rs.
                    "super" => drop(path.pop()),
                    name => path.push(name.to_string()),
                }
            }
            paths.push(path);
        }
    }
    paths
}

/// Returns the imports between files, without those from a parent module, which re-exports names of its children.
fn imports() -> BTreeMap<Vec<String>, BTreeSet<Vec<String>>> {
    let mut files = BTreeMap::new();
    for room in ROOMS {
        modules(&source().join(room), &[room.to_string()], &mut files);
    }
    let resolve = |path: &[String]| {
        let longest = (1..=path.len()).rev().map(|n| path[..n].to_vec()).find(|path| files.contains_key(path));
        longest.unwrap_or_default()
    };
    files
        .iter()
        .filter(|(module, _)| module.last().is_none_or(|name| name != "tests"))
        .map(|(module, file)| {
            let targets = referenced(module, &code(file)).into_iter().map(|path| resolve(&path));
            let others = targets.filter(|target| !target.is_empty() && !module.starts_with(target));
            (module.clone(), others.collect())
        })
        .collect()
}

#[test]
fn no_module_imports_a_higher_module() {
    let rank = |module: &[String]| ROOMS.iter().position(|room| *room == module[0]).unwrap();
    let imports = imports();
    // Detects a parser that misses imports. The actual number is far greater.
    assert!(imports.values().map(BTreeSet::len).sum::<usize>() > 250, "too few imports were parsed");
    for (module, targets) in imports {
        for target in targets {
            assert!(rank(&target) <= rank(&module), "{} imports {}", module.join("::"), target.join("::"));
        }
    }
}

#[test]
fn files_have_no_import_cycles() {
    let imports = imports();
    // Repeatedly removes the files that import no remaining file. The files left at the end are in or above a cycle.
    let mut left: BTreeSet<&Vec<String>> = imports.keys().collect();
    loop {
        let free: Vec<_> = left
            .iter()
            .copied()
            .filter(|module| !imports[*module].iter().any(|target| left.contains(target) && target != *module))
            .collect();
        if free.is_empty() {
            break;
        }
        left.retain(|module| !free.contains(module));
    }
    let cycles: Vec<String> = left.iter().map(|module| module.join("::")).collect();
    assert!(cycles.is_empty(), "in or above an import cycle: {cycles:#?}");
}
