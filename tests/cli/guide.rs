//! The guide: every command runs, and every link has a target.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use assert_cmd::cargo::cargo_bin;
use tempfile::TempDir;

use crate::desk::choose_device;

/// Marks the next block as slow. `tools/demo` runs its commands instead of this test.
const SLOW: &str = "<!-- slow: run by tools/demo -->";

fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn source() -> PathBuf {
    project().join("docs/guide/src")
}

fn text(name: &str) -> String {
    fs::read_to_string(source().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The targets of Markdown links, `](target)`.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link)
}

/// The chapter files, in the order of SUMMARY.md.
fn chapters() -> Vec<String> {
    links(&text("SUMMARY.md")).map(String::from).collect()
}

/// A command of an `sh` block. `slow` is set if the block is marked with `SLOW`.
struct Line {
    text: String,
    slow: bool,
}

/// The commands of a chapter. Continued lines are joined.
fn commands(chapter: &str) -> Vec<Line> {
    let (mut found, mut block, mut before) = (Vec::<Line>::new(), None, "");
    let joined = chapter.replace("\\\n", " ");
    for line in joined.lines() {
        match block {
            None if line == "```sh" => block = Some(before == SLOW),
            Some(_) if line == "```" => block = None,
            Some(slow) => found.push(Line { text: one_space(line), slow }),
            None => before = line,
        }
    }
    found
}

fn one_space(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Runs one line like a shell. It supports only words and `> FILE`.
fn run(line: &str, folder: &Path, cache: &Path) {
    let (line, into) = line.split_once(" > ").map_or((line, None), |(line, file)| (line, Some(file)));
    let mut words = line.split(' ');
    assert_eq!(words.next(), Some("parfocal"), "{line}: sh blocks may hold only parfocal commands");
    assert!(!line.contains(['\'', '"', '$', '|', '*', '#']), "{line}: uses shell syntax other than words and > FILE");
    let words: Vec<&str> = words.collect();
    let mut command = Command::new(cargo_bin("parfocal"));
    command.current_dir(folder).env("PARFOCAL_CACHE_DIR", cache).args(&words);
    choose_device(&mut command, false);
    let output = command.output().unwrap();
    if let Some(file) = into {
        fs::write(folder.join(file), &output.stdout).unwrap();
    }
    let stderr = String::from_utf8_lossy(&output.stderr);
    println!("$ {line}\n{stderr}");
    assert!(output.status.success(), "{line}: {stderr}");
}

#[test]
fn every_command_of_the_guide_works() {
    let cache = TempDir::new().unwrap();
    let demo = one_space(&fs::read_to_string(project().join("tools/demo")).unwrap().replace("\\\n", " "));
    for chapter in chapters() {
        println!("--- {chapter}");
        let folder = TempDir::new().unwrap();
        for line in commands(&text(&chapter)) {
            match line.text.strip_prefix("parfocal ").filter(|_| line.slow) {
                Some(arguments) => assert!(demo.contains(arguments), "{chapter}: tools/demo does not run {arguments}"),
                None => run(&line.text, folder.path(), cache.path()),
            }
        }
    }
}

#[test]
fn every_chapter_example_and_picture_is_linked() {
    let listed: BTreeSet<String> = chapters().into_iter().collect();
    let names = |folder: PathBuf| -> BTreeSet<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    };
    let mut written = names(source());
    for other in ["SUMMARY.md", "pictures", "examples"] {
        assert!(written.remove(other), "{other} is missing");
    }
    assert_eq!(written, listed, "the chapter files differ from those in SUMMARY.md");
    let all: String = listed.iter().map(|chapter| text(chapter)).collect();
    for example in names(source().join("examples")) {
        assert!(all.contains(&format!("](examples/{example})")), "no chapter links to {example}");
    }
    for picture in names(source().join("pictures")) {
        assert!(all.contains(&format!("](pictures/{picture})")), "no chapter shows {picture}");
        let bytes = fs::metadata(source().join("pictures").join(&picture)).unwrap().len();
        assert!(bytes < 150_000, "{picture} has {bytes} bytes");
    }
}

/// The anchor that GitHub and mdBook generate for a heading.
fn anchor(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    heading.trim().to_lowercase().replace(' ', "-").chars().filter(kept).collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    let heading = |line: &str| line.starts_with('#').then(|| anchor(line.trim_start_matches('#')));
    text.lines().filter_map(heading).collect()
}

#[test]
fn every_link_has_an_existing_target() {
    let mut files = chapters();
    files.push("SUMMARY.md".to_string());
    for file in files {
        // A link may span two lines.
        for link in links(&text(&file).replace('\n', " ")).filter(|link| !link.contains("://")) {
            let (path, place) = link.split_once('#').map_or((link, None), |(path, place)| (path, Some(place)));
            let target = if path.is_empty() { file.as_str() } else { path };
            assert!(source().join(target).exists(), "{file}: the target of {link} does not exist");
            if let Some(place) = place {
                assert!(anchors(&text(target)).contains(place), "{file}: {target} has no heading for #{place}");
            }
        }
    }
}
