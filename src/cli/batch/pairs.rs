//! The pairs and sweeps of a folder, by the names of its files, or of a manifest, and their names.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use parfocal::image_io::{PageStack, RawFormat};
use parfocal::internals::bounded_read;

use crate::cli::batch::manifest;
use crate::cli::batch::summary::is_of_batch;
use crate::cli::options::photographs::{SweepFiles, foreign_files, in_short, list_folder, one_series, with_format};
use crate::cli::options::series::{self, file_name, stem};
use crate::cli::output::destination::same_file;
use crate::cli::output::failure::Failure;

/// The photographs of a pair or a sweep in order, and the name of the folder of their results.
#[derive(Clone, Debug, Default)]
pub(crate) struct Group {
    pub(crate) name: String,
    pub(crate) files: Vec<PathBuf>,
    /// Names of the photographs beside the frames of a sweep that do not belong to their series.
    pub(crate) left_out: Vec<String>,
    /// The reason why it cannot be solved.
    pub(crate) problem: Option<String>,
    /// Whether it is the folder of a part without a pair or a sweep, to which photographs may be added.
    pub(crate) is_incomplete: bool,
}

/// The pairs and sweeps of a folder or a manifest.
#[derive(Debug, Default)]
pub(crate) struct Grouped {
    pub(crate) groups: Vec<Group>,
    /// Photographs that belong to no pair or sweep, and the reasons, one line each.
    pub(crate) left_over: Vec<String>,
}

/// The rules for pairs and manifests, for `--help`.
pub(crate) const RULE: &str = "\
Pairs of a folder: photographs whose names differ only at the end are pairs, in the order of the ends. An end is a number \
(shot_1.png shot_2.png; IMG_0417.tif IMG_0418.tif IMG_0419.tif IMG_0420.tif are two pairs), _near and _far, or _a and \
_b; the first is I1. Photographs without a pair are reported and ignored, and so is a series of more than two beside other \
photographs. If the folder holds folders and no photographs, the rule applies to each of them; but three or more \
photographs whose names differ only in their numbers are a focus sweep, in the order of the numbers. Photographs beside \
them are reported and ignored.

A manifest is CSV, lines of I1,I2 or I1,I2,NAME (or with semicolons; a header is allowed, # begins a comment), or JSON lines, \
{\"i1\": FILE, \"i2\": FILE, \"name\": NAME}, the name optional; {\"sweep\": FOLDER} or {\"sweep\": [FILE, ...]} is a focus \
sweep. Paths are relative to the folder of the manifest.";

/// A search for pairs and sweeps.
#[derive(Clone, Copy)]
pub(crate) struct Search<'a> {
    /// The folder, or the manifest.
    pub(crate) folder: &'a Path,
    /// The folder of the results, which are left out.
    pub(crate) out: &'a Path,
    pub(crate) raw: Option<RawFormat>,
    /// Whether each inner folder is a part that needs a verdict, so that one without a pair or a sweep is a group that
    /// cannot be solved.
    pub(crate) is_judged: bool,
}

impl Search<'_> {
    /// The pairs and sweeps that the folder has so far, possibly none.
    pub(crate) fn so_far(&self) -> Result<Grouped, Failure> {
        let Grouped { groups, left_over } = self.of_folder()?;
        let candidates = groups.into_iter().map(Candidate::of_folder).collect();
        settled(candidates, left_over, self.raw).map_err(|problem| self.failed(&problem))
    }

    /// The pairs and sweeps of the folder or the manifest.
    pub(crate) fn find(&self) -> Result<Grouped, Failure> {
        let source = self.folder;
        let found = if source.is_dir() {
            self.so_far()?
        } else if source.exists() {
            settled(of_manifest(source, self.raw)?, Vec::new(), self.raw).map_err(|problem| self.failed(&problem))?
        } else {
            let hint = crate::cli::output::failure::did_you_mean(source);
            let missing = || format!("there is no such folder or manifest{hint}");
            return Err(self.failed(&bounded_read::not_a_path(source).map_or_else(missing, String::from)));
        };
        if found.groups.is_empty() {
            let problem = "holds no pair of photographs; see `parfocal batch --help` for how they are named";
            let besides = foreign_files(source).map(|besides| format!("it holds {besides}"));
            let problem = [&[problem.to_string()], found.left_over.as_slice(), besides.as_slice()].concat();
            return Err(self.failed(&in_short(&problem, "; ")));
        }
        Ok(found)
    }

    fn failed(&self, problem: &str) -> Failure {
        Failure::file(self.folder, problem)
    }

    fn of_folder(&self) -> Result<Grouped, Failure> {
        let Self { folder, out, raw, is_judged } = *self;
        let (files, folders) = list_folder(folder, raw)?;
        if !files.is_empty() {
            return Ok(by_name(&files));
        }
        let mut all = Grouped::default();
        for inner in folders.iter().filter(|inner| !same_file(inner, out)) {
            let folder_name = inner.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let files = match list_folder(inner, raw) {
                Ok((files, _)) => files,
                // Removed since its folder was listed.
                Err(_) if !inner.exists() => continue,
                Err(failure) if is_judged => {
                    let problem = Some(failure.message());
                    all.groups.push(Group { name: folder_name, problem, ..Group::default() });
                    continue;
                }
                Err(failure) => {
                    all.left_over.push(failure.message());
                    continue;
                }
            };
            if let [file] = &files[..]
                && let Ok(Some(PageStack { frames, .. })) = PageStack::read(file, [None; 2])
            {
                all.groups.push(Group { name: folder_name, files: frames, ..Group::default() });
                continue;
            }
            if let Some(SweepFiles { frames, left_out, .. }) = one_series(&files) {
                all.groups.push(Group { name: folder_name, files: frames, left_out, ..Group::default() });
                continue;
            }
            let found = by_name(&files);
            if is_judged && found.groups.is_empty() {
                let problem = match found.left_over.as_slice() {
                    [] => format!("{}: holds no photograph that parfocal reads", inner.display()),
                    several => format!("{}: {}", inner.display(), in_short(several, "; ")),
                };
                let group = Group { name: folder_name, files, problem: Some(problem), ..Group::default() };
                all.groups.push(Group { is_incomplete: true, ..group });
                continue;
            }
            let only = found.groups.len() == 1;
            all.groups.extend(found.groups.into_iter().map(|pair| {
                let name = if only { folder_name.clone() } else { format!("{folder_name}-{}", pair.name) };
                Group { name, ..pair }
            }));
            all.left_over.extend(found.left_over.into_iter().map(|problem| format!("{folder_name}: {problem}")));
        }
        Ok(all)
    }
}

/// Gives each pair or sweep a unique name, and adds the format to its files without a header. Adds to `left_over` what
/// lies beside the frames of sweeps.
fn settled(pairs: Vec<Candidate>, mut left_over: Vec<String>, raw: Option<RawFormat>) -> Result<Grouped, String> {
    let mut groups = named_apart(pairs)?;
    for Group { name, files, left_out, .. } in groups.iter().filter(|group| !group.left_out.is_empty()) {
        left_over.push(format!("{name}: {}: not named like {}", in_short(left_out, ", "), series::ends(files)));
    }
    for file in groups.iter_mut().flat_map(|group| &mut group.files) {
        *file = with_format(std::mem::take(file), raw);
    }
    Ok(Grouped { groups, left_over })
}

/// The kind of the last part of a name. It orders photographs with the same other parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Number,
    NearFar,
    Letter,
}

/// Splits a stem before its last part; `None` if this part defines no order.
fn split(stem: &str) -> Option<(&str, Kind, u64)> {
    let rest = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    if rest.len() < stem.len() {
        // A number of more than 18 digits is a date or a hash. Its last 18 digits are used.
        let digits = &stem[rest.len()..];
        let last = &digits[digits.len().saturating_sub(18)..];
        return Some((rest, Kind::Number, last.parse().ok()?));
    }
    let lower = stem.to_ascii_lowercase();
    let words = [("near", Kind::NearFar, 0), ("far", Kind::NearFar, 1), ("a", Kind::Letter, 0), ("b", Kind::Letter, 1)];
    words.into_iter().find_map(|(word, kind, order)| {
        let rest = &stem[..lower.strip_suffix(word)?.len()];
        (rest.is_empty() || rest.ends_with(['_', '-', '.', ' '])).then_some((rest, kind, order))
    })
}

/// Pairs files by their names. Returns the files without a pair. All files of a series of odd length are returned,
/// since it is unknown which file is missing. So are those of a series of more than two beside other files: it may be a
/// focus sweep. A series in which two files have one place is one pair that cannot be solved.
fn by_name(files: &[PathBuf]) -> Grouped {
    let mut doubled: BTreeMap<(String, Kind), [&PathBuf; 2]> = BTreeMap::new();
    let mut series: BTreeMap<(String, Kind), BTreeMap<u64, &PathBuf>> = BTreeMap::new();
    let mut found = Grouped::default();
    for file in files {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let Some((rest, kind, order)) = split(&stem) else {
            found.left_over.push(format!("{} belongs to no pair: {ENDS}", file_name(file)));
            continue;
        };
        let key = (rest.to_string(), kind);
        if let Some(other) = series.entry(key.clone()).or_default().insert(order, file) {
            doubled.entry(key).or_insert([other, file]);
        }
    }
    for (key, members) in &series {
        let members: Vec<&PathBuf> = members.values().copied().collect();
        let trimmed = key.0.trim_end_matches(['_', '-', '.', ' ']);
        if let Some(two) = doubled.get(key) {
            let name = if trimmed.is_empty() { stem(two[0]) } else { trimmed.to_string() };
            let [first, second] = two.map(|file| file_name(file));
            let problem = Some(format!("{first} and {second} have one place in their pair; move one away"));
            let files = two.map(PathBuf::clone).to_vec();
            found.groups.push(Group { name, files, problem, ..Group::default() });
            let others = members.iter().filter(|file| !two.contains(*file));
            found.left_over.extend(others.map(|file| {
                format!("{} is left over: {first} and {second} of its series have one place", file_name(file))
            }));
            continue;
        }
        if let [first, .., last] = members[..]
            && members.len() > 2
            && members.len() < files.len()
        {
            found.left_over.push(format!(
                "{} to {} are a series of {} beside other photographs: {APART}",
                file_name(first),
                file_name(last),
                members.len()
            ));
            continue;
        }
        if let [.., last] = members[..]
            && members.len() % 2 == 1
        {
            let of = if members.len() > 1 { format!(", of a series of {}", members.len()) } else { String::new() };
            found.left_over.push(format!("{} is left over{of}: {ENDS}", file_name(last)));
            continue;
        }
        for two in members.chunks_exact(2) {
            let name = if members.len() == 2 && !trimmed.is_empty() { trimmed.to_string() } else { stem(two[0]) };
            let files = two.iter().map(|file| (*file).clone()).collect();
            found.groups.push(Group { name, files, ..Group::default() });
        }
    }
    found
}

const ENDS: &str = "names of a pair differ only in a number, near and far, or a and b at their end; rename it, move it \
                    away, or give a manifest";

const APART: &str = "put each focus sweep, or each pair, into a folder of its own, or give a manifest";

fn of_manifest(file: &Path, raw: Option<RawFormat>) -> Result<Vec<Candidate>, Failure> {
    let failed = |problem: String| Failure::file(file, problem);
    let folder = file.parent().unwrap_or(Path::new(""));
    let (mut pairs, mut given) = (Vec::new(), HashMap::new());
    for (number, line) in manifest::read(file)? {
        let name = line.name.clone().filter(|name| !name.is_empty());
        if let Some(name) = name.as_ref().filter(|name| !is_folder_name(name) || name.contains(':')) {
            return Err(failed(format!(
                "line {number}: '{name}' cannot name a folder; give another name, without slashes"
            )));
        }
        if let Some(name) = &name
            && let Some(other) = given.insert(name.to_lowercase(), number)
        {
            return Err(failed(format!("line {number}: '{name}' is the name in line {other} already; give another")));
        }
        let is_given = name.is_some();
        let (SweepFiles { frames: files, left_out, .. }, otherwise) =
            line.files(folder, raw).map_err(|problem| failed(format!("line {number}: {problem}")))?;
        let pair = Group { name: name.unwrap_or(otherwise), files, left_out, ..Group::default() };
        pairs.push(Candidate { pair, line: Some(number), is_given });
    }
    Ok(pairs)
}

/// Reads a file, for fuzz tests.
#[cfg(test)]
pub(crate) fn reads(file: &Path) {
    let _ = of_manifest(file, None);
}

/// Whether a name is valid for a visible folder directly in the folder of results.
fn is_folder_name(name: &str) -> bool {
    let elsewhere = name.is_empty() || name.starts_with('.') || name.contains(['/', '\\']);
    let is_none = cfg!(windows) && !bounded_read::is_name_of_windows(name);
    !elsewhere && !is_none && !name.chars().any(char::is_control) && !is_of_batch(name)
}

/// A pair, before its name is final.
struct Candidate {
    pair: Group,
    /// The line number in the manifest.
    line: Option<usize>,
    /// Whether the manifest states the name.
    is_given: bool,
}

impl Candidate {
    fn of_folder(pair: Group) -> Self {
        Self { pair, line: None, is_given: false }
    }

    /// The position of the pair, for messages.
    fn place(&self) -> String {
        let i1 = self.pair.files.first().map_or(self.pair.name.clone(), |file| file.display().to_string());
        self.line.map_or(i1.clone(), |line| format!("line {line}, {i1}"))
    }
}

/// Adds the folder of I1 to equal names, unless they are stated. Names that are still equal, or that cannot be the name
/// of a folder, are errors of a manifest. In a folder, such a pair has a problem, and the others are solved.
fn named_apart(mut pairs: Vec<Candidate>) -> Result<Vec<Group>, String> {
    let mut count: HashMap<String, usize> = HashMap::new();
    pairs.iter().for_each(|Candidate { pair, .. }| *count.entry(pair.name.to_lowercase()).or_default() += 1);
    for Candidate { pair, .. } in pairs.iter_mut().filter(|c| !c.is_given && count[&c.pair.name.to_lowercase()] > 1) {
        let Some(first) = pair.files.first() else { continue };
        let folder = first.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
        let folder = folder.filter(|name| is_folder_name(name)).map_or(String::new(), |name| format!("{name}-"));
        pair.name = format!("{folder}{}", stem(first));
    }
    let all: HashSet<String> = pairs.iter().map(|candidate| candidate.pair.name.to_lowercase()).collect();
    let mut seen: HashMap<String, String> = HashMap::new();
    for candidate in &mut pairs {
        let (name, place) = (candidate.pair.name.clone(), candidate.place());
        let how = match candidate.line {
            Some(_) => "give another name after I2",
            None => "rename the photographs, or name them in a manifest",
        };
        let problem = if let Some(other) = seen.get(&name.to_lowercase()) {
            // Each row of the summary needs a name of its own.
            let free = (2..).map(|n| format!("{name} ({n})")).find(|name| {
                let name = name.to_lowercase();
                !seen.contains_key(&name) && !all.contains(&name)
            });
            candidate.pair.name = free.unwrap_or_default();
            format!("the pairs of {other} and {place} are both called '{name}'; {how}")
        } else if !is_folder_name(&name) {
            format!("{place}: '{name}' cannot name a folder of results; {how}")
        } else {
            seen.insert(name.to_lowercase(), place);
            continue;
        };
        if candidate.line.is_some() {
            return Err(problem);
        }
        seen.insert(candidate.pair.name.to_lowercase(), place);
        candidate.pair.problem.get_or_insert(problem);
    }
    Ok(pairs.into_iter().map(|candidate| candidate.pair).collect())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;

    fn names(files: &[&str]) -> Result<Vec<String>, String> {
        let files: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
        let show = |p: Group| format!("{} {} {}", p.name, p.files[0].display(), p.files[1].display());
        let found = by_name(&files);
        if let Some(problem) = found.groups.iter().find_map(|group| group.problem.clone()) {
            return Err(problem);
        }
        if found.left_over.is_empty() {
            return Ok(found.groups.into_iter().map(show).collect());
        }
        Err(format!("{}; {}", found.groups.len(), found.left_over.join("; ")))
    }

    #[test]
    fn names_that_differ_only_at_their_end_are_pairs() {
        let found = names(&["b_far.tif", "b_near.tif", "a_1.png", "a_2.png", "x-A.jpg", "x-B.jpg"]).unwrap();
        assert_eq!(found, ["a a_1.png a_2.png", "b b_near.tif b_far.tif", "x x-A.jpg x-B.jpg"]);
        let found = names(&["IMG_9.png", "IMG_10.png", "IMG_11.png", "IMG_12.png"]).unwrap();
        assert_eq!(found, ["IMG_9 IMG_9.png IMG_10.png", "IMG_11 IMG_11.png IMG_12.png"]);
        assert_eq!(names(&["1.png", "2.png"]).unwrap(), ["1 1.png 2.png"]);
        assert_eq!(names(&["far.png", "near.png"]).unwrap(), ["near near.png far.png"]);
    }

    #[test]
    fn a_photograph_without_a_pair_is_reported() {
        for (files, part) in [
            (&["a_1.png", "a_2.png", "a_3.png"][..], "0; a_3.png is left over, of a series of 3"),
            (&["a_1.png", "a_2.png", "b_7.png"], "1; b_7.png is left over:"),
            (&["a_1.png", "a_2.png", "banana.png"], "1; banana.png belongs to no pair"),
            (&["1.png", "2.png", "3.png", "4.png", "mask.png"], "0; mask.png belongs to no pair"),
            (
                &["1.png", "2.png", "3.png", "4.png", "mask.png"],
                "1.png to 4.png are a series of 4 beside other photographs",
            ),
            (&["a1.png", "a2.png", "a3.png", "a4.png", "b1.png", "b2.png"], "1; a1.png to a4.png are a series of 4"),
            (&["a1.png", "a2.png", "a3.png", "a4.png", "b1.png", "b2.png", "b3.png"], "0; a1.png to a4.png"),
            (&["a_1.png", "a_1.jpg"], "a_1.png and a_1.jpg have one place"),
        ] {
            let problem = names(files).unwrap_err();
            assert!(problem.contains(part), "{problem}");
        }
    }

    fn search(folder: &Path) -> Result<Grouped, Failure> {
        Search { folder, out: Path::new("out"), raw: None, is_judged: false }.find()
    }

    #[test]
    fn a_pair_of_a_folder_without_a_valid_name_does_not_stop_the_others() {
        let folder = TempDir::new().unwrap();
        let pairs = ["good", "a\\b", "tab\there", "index.html", "Batch-2-of-3.json", "batch-2-of-x.json", "x", "X"];
        for name in pairs.iter().flat_map(|name| [format!("{name}_1.png"), format!("{name}_2.png")]) {
            fs::write(folder.path().join(name), "").unwrap();
        }
        fs::write(folder.path().join("doubled_1.png"), "").unwrap();
        fs::write(folder.path().join("doubled_1.jpg"), "").unwrap();
        let found = search(folder.path()).unwrap().groups;
        let (refused, good): (Vec<_>, Vec<_>) = found.iter().partition(|group| group.problem.is_some());
        let names = |groups: &[&Group]| groups.iter().map(|group| group.name.clone()).collect::<Vec<_>>();
        // The names of two pairs that differ in case only begin with the name of their folder.
        let own = file_name(folder.path());
        let own = if is_folder_name(&own) { format!("{own}-") } else { String::new() };
        assert_eq!(names(&good), [format!("{own}X_1"), "batch-2-of-x.json".to_string(), "good".to_string()]);
        let twice = format!("{own}x_1 (2)");
        assert_eq!(names(&refused), ["Batch-2-of-3.json", "a\\b", "doubled", "index.html", "tab\there", &twice]);
        for (group, part) in refused.iter().zip(["cannot name", "cannot name", "have one place", "cannot name"]) {
            assert!(group.problem.as_ref().unwrap().contains(part), "{group:?}");
        }
        assert!(refused[5].problem.as_ref().unwrap().contains("are both called"), "{:?}", refused[5]);
    }

    fn of_text(text: &str) -> Result<Vec<Group>, String> {
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("list");
        fs::write(&file, text).unwrap();
        match search(&file) {
            Ok(found) => Ok(found.groups),
            Err(Failure::Failed(message)) => Err(message.split_once("list: ").unwrap().1.to_string()),
            Err(other) => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_manifest_is_csv_or_json_lines() {
        for text in [
            "# the first\nI1,I2,name\nx/a.png, x/b.png, one\ny/a.png,y/b.png\n",
            "near;far;called\nx/a.png; x/b.png; one\ny/a.png;y/b.png\n",
            "first\tsecond\nx/a.png\tx/b.png\tone\ny/a.png\ty/b.png\n",
            "{\"i1\": \"x/a.png\", \"i2\": \"x/b.png\", \"name\": \"one\"}\n\n{\"i1\": \"y/a.png\", \"i2\": \"y/b.png\"}",
        ] {
            let pairs = of_text(text).unwrap();
            assert_eq!(pairs.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["one", "a"]);
            assert!(pairs[0].files[0].ends_with("x/a.png") && pairs[0].files[0].is_absolute());
        }
        let pairs = of_text("x/i1.png,x/i2.png\ny/i1.png,y/i2.png\n").unwrap();
        assert_eq!(pairs.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["x-i1", "y-i1"]);
    }

    #[test]
    fn an_error_of_a_manifest_states_its_line() {
        for (text, part) in [
            ("a.png,b.png\nc.png\n", "line 2: is not I1,I2"),
            ("a.png,b.png\n...png,b.png\n", "line 2, "),
            ("...png,b.png\n", "'..' cannot name a folder of results"),
            ("..,b.png\n", "'' cannot name a folder of results"),
            ("x/..png,b.png\n", "'.' cannot name a folder of results"),
            ("x/a\\b.png,b.png\n", "'a\\b' cannot name a folder of results"),
            ("batch.json.png,b.png\n", "'batch.json' cannot name a folder of results"),
            ("a.png,b.png,Batch.json\n", "line 1: 'Batch.json' cannot name a folder"),
            ("{\"i1\": \"...png\", \"i2\": \"b\"}\n", "line 1, "),
            ("x/a.png,b.png\ny/c.png,d.png,x-a\nz/A.png,e.png\n", "line 2, "),
            ("a.png,b.png,../up\n", "line 1: '../up' cannot name a folder"),
            ("{\"i1\": \"a\"}\n", "line 1: is not {\"i1\""),
            ("a.png,b.png,x\nc.png,d.png,X\n", "line 2: 'X' is the name in line 1"),
            ("a.png,b.png\na.png,c.png\n", "are both called '"),
            ("", "holds no pair"),
        ] {
            let problem = of_text(text).unwrap_err();
            assert!(problem.contains(part), "{problem}");
        }
    }
}
