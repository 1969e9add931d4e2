//! Tests of the imports in `src/`: a module imports only lower modules, and files have no import cycles.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Top-level modules, lowest first. `solve` and `metric` do not import each other.
const ROOMS: [&str; 8] = ["base", "engine", "solve", "metric", "files", "page", "lab", "cli"];

/// A path of names from the root of the crate: `["engine", "stages"]` is `engine/stages/mod.rs`.
type Names = Vec<String>;

/// A source file: the code without its imports, and what the names in its scope stand for.
struct Module {
    code: String,
    /// Names of imports and of child modules, with their paths.
    scope: BTreeMap<String, Names>,
    /// Names that the file imports only to export them. They are no imports of the file unless its code uses them.
    exported: BTreeSet<String>,
}

/// Returns all files of a folder by their paths.
fn modules(folder: &Path, path: &[String]) -> BTreeMap<Names, Module> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let stem = entry.file_stem().unwrap().to_string_lossy().into_owned();
        let own = [path, std::slice::from_ref(&stem)].concat();
        if entry.is_dir() {
            files.extend(modules(&entry, &own));
        } else if entry.extension().is_some_and(|e| e == "rs") && !["main", "tests"].contains(&&*stem) {
            let own = if stem == "mod" || stem == "lib" { path.to_vec() } else { own };
            files.insert(own.clone(), parse(&own, &fs::read_to_string(&entry).unwrap()));
        }
    }
    files
}

/// Returns the lines of a file without comments and without items that only tests have.
fn code(text: &str) -> impl Iterator<Item = &str> {
    let mut lines = text.lines();
    std::iter::from_fn(move || {
        loop {
            let line = lines.next()?;
            let indent = |line: &str| line.len() - line.trim_start().len();
            if line.trim().starts_with("#[cfg(test)]") || line.trim().starts_with("#[cfg(all(test") {
                lines.find(|next| indent(next) == indent(line) && next.ends_with([';', '}', ',']));
            } else if !line.trim().starts_with("//") {
                return Some(line.trim());
            }
        }
    })
}

/// Parses a file.
fn parse(module: &[String], text: &str) -> Module {
    let mut parsed = Module { code: String::new(), scope: BTreeMap::new(), exported: BTreeSet::new() };
    let mut imports = Vec::new();
    let mut folder = Vec::new();
    let mut lines = code(text);
    while let Some(line) = lines.next() {
        let item = line.strip_prefix("pub").map_or(line, |rest| rest.split_once(") ").map_or(rest, |(_, rest)| rest));
        if let Some(tree) = item.trim().strip_prefix("use ") {
            let mut tree = tree.to_string();
            while !tree.contains(';') {
                tree += lines.next().unwrap();
            }
            let mut paths = Vec::new();
            leaves(&folder, &tree[..tree.find(';').unwrap()], &mut paths);
            imports.extend(paths.into_iter().map(|path| (path, line.starts_with("pub"))));
        } else if let Some(name) = item.trim().strip_prefix("mod ") {
            // A module with braces has only child modules, those of a folder without a mod.rs, or imports.
            let name = name.trim_end_matches([';', '{', ' ']).to_string();
            let path = [module, &folder, std::slice::from_ref(&name)].concat();
            parsed.scope.insert(name.clone(), path);
            if item.ends_with('{') {
                folder.push(name);
            }
        } else if line == "}" && !folder.is_empty() {
            folder.pop();
        } else {
            // Without `pub(super)`, which imports nothing.
            parsed.code += if line.starts_with("pub(") { item } else { line };
            parsed.code.push('\n');
        }
    }
    for (mut path, public) in imports {
        let name = path.split_off(path.len() - 1).remove(0);
        let (item, name) = name.split_once(" as ").unwrap_or((&name, &name));
        path.extend((item != "self").then(|| item.to_string()));
        let name = if name == "self" { path.last().unwrap().clone() } else { name.to_string() };
        if public {
            parsed.exported.insert(name.clone());
        }
        if let Some(path) = parsed.absolute(module, &path) {
            parsed.scope.insert(name, path);
        }
    }
    parsed
}

/// Adds the paths of a tree of imports, such as `a::{b, c::d}`.
fn leaves(prefix: &[String], tree: &str, into: &mut Vec<Names>) {
    let names = |path: &str| path.split("::").map(|name| name.trim().to_string()).collect::<Names>();
    let Some((head, body)) = tree.split_once("::{") else {
        into.extend((!tree.trim().is_empty()).then(|| [prefix, &names(tree)].concat()));
        return;
    };
    let prefix = [prefix, &names(head)].concat();
    let body = body.rsplit_once('}').unwrap().0;
    let (mut depth, mut start) = (0, 0);
    for (i, c) in body.char_indices().chain([(body.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                leaves(&prefix, &body[start..i], into);
                start = i + 1;
            }
            _ => {}
        }
    }
}

impl Module {
    /// Returns a path as seen from the root of the crate, or `None` for other crates and local types.
    fn absolute(&self, module: &[String], path: &[String]) -> Option<Names> {
        let start = match &*path[0] {
            "crate" => Vec::new(),
            "self" => module.to_vec(),
            "super" => {
                let up = path.iter().take_while(|name| *name == "super").count();
                return Some([&module[..module.len() - up], &path[up..]].concat());
            }
            name => self.scope.get(name)?.clone(),
        };
        Some([&start, &path[1..]].concat())
    }

    /// Returns what the code of the file names. A word alone is an item, or a local variable with the name of a module.
    fn named(&self, module: &[String], files: &BTreeMap<Names, Module>) -> Vec<Names> {
        let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
        let words = self.code.split(|c: char| !is_part(c)).map(|word| word.trim_matches(':'));
        let paths = words.filter(|word| !word.is_empty()).filter_map(|word| {
            let path = self.absolute(module, &word.split("::").map(str::to_string).collect::<Names>())?;
            (word.contains("::") || !files.contains_key(&path)).then_some(path)
        });
        paths.collect()
    }
}

/// Returns the file that defines what a path names, through all files that export it.
fn definition(files: &BTreeMap<Names, Module>, path: &[String]) -> Names {
    let depth = (0..=path.len()).rev().find(|n| files.contains_key(&path[..*n])).unwrap();
    let (module, rest) = path.split_at(depth);
    match rest.first().and_then(|name| files[module].scope.get(name)) {
        Some(target) if files[module].exported.contains(&rest[0]) && target[..] != *path => {
            definition(files, &[target, &rest[1..]].concat())
        }
        _ => module.to_vec(),
    }
}

/// Returns the files whose items each file names.
fn imports() -> BTreeMap<Names, BTreeSet<Names>> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files = modules(&source, &[]);
    let mut imports = BTreeMap::new();
    for (module, file) in files.iter().filter(|(module, _)| !module.is_empty()) {
        let mut targets: BTreeSet<_> = file.named(module, &files).iter().map(|path| definition(&files, path)).collect();
        targets.remove(module);
        targets.remove(&Vec::new());
        imports.insert(module.clone(), targets);
    }
    imports
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
    let mut reached = imports.clone();
    loop {
        let before: usize = reached.values().map(BTreeSet::len).sum();
        for module in imports.keys() {
            let further: Vec<_> = reached[module].iter().flat_map(|target| &reached[target]).cloned().collect();
            reached.get_mut(module).unwrap().extend(further);
        }
        if reached.values().map(BTreeSet::len).sum::<usize>() == before {
            break;
        }
    }
    // Two files are in one cycle if each reaches the other.
    let mut cycles = BTreeMap::<Vec<&Names>, Vec<String>>::new();
    for (module, targets) in &reached {
        let cycle: Vec<_> = targets.iter().filter(|target| reached[*target].contains(module)).collect();
        for target in cycle.iter().filter(|target| imports[module].contains(**target)) {
            cycles.entry(cycle.clone()).or_default().push(format!(
                "{} imports {}",
                module.join("::"),
                target.join("::")
            ));
        }
    }
    assert!(cycles.is_empty(), "cycles of imports: {:#?}", cycles.values().collect::<Vec<_>>());
}
