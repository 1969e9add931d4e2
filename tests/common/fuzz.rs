//! A fuzzer: runs readers on mutated files in child processes with limits of memory and time. The number of a case
//! determines its file.

use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::trust;

/// A reader, a corpus of valid files, and the name of the file that the reader opens.
pub struct Target {
    pub name: &'static str,
    pub file: &'static str,
    pub corpus: Vec<Vec<u8>>,
    /// Reads a file and ignores the result.
    pub read: fn(&Path),
}

/// Address space of a child process, KiB. Images have at most one megapixel.
const MEMORY: u32 = 256 << 10;
/// Time limit of a case.
const LONGEST: Duration = Duration::from_secs(1);
/// Time without a new case after which a child counts as hung. It allows for a busy machine.
const HANGS: Duration = Duration::from_secs(20);
/// Environment variable with the task of a child: target, first case, end, and folder.
const CHILD: &str = "PARFOCAL_FUZZ_CHILD";

/// Number of cases of each target in a short and in a long run.
pub struct Share {
    pub short: u64,
    pub long: u64,
}

/// Runs the targets in child processes of the named test. Fails if a case crashes, panics, hangs, or exceeds a limit.
pub fn run(test: &str, targets: &[Target], share: &Share) {
    if let Ok(task) = std::env::var(CHILD) {
        return child(targets, &task);
    }
    let cases = if trust::is_long() { share.long } else { share.short };
    let findings: Vec<String> = targets.iter().flat_map(|target| parent(test, target, cases)).collect();
    trust::note(&format!("inputs of {test}"), cases * targets.len() as u64);
    trust::note(&format!("findings of {test}"), findings.len());
    assert!(findings.is_empty(), "{findings:#?}");
}

/// Runs all cases of a target in child processes. Returns the findings.
fn parent(test: &str, target: &Target, cases: u64) -> Vec<String> {
    let mut findings = Vec::new();
    let mut first = 0;
    // Stops after 20 findings: many findings usually have one cause.
    while first < cases && findings.len() < 20 {
        let desk = desk();
        let task = format!("{}\n{first}\n{cases}\n{}", target.name, desk.path().display());
        // A file, not a pipe: messages of caught panics would fill an unread pipe and block the child.
        let stderr = desk.path().join("stderr");
        let mut child = Command::new("sh")
            .args(["-c", &format!("ulimit -v {MEMORY}; ulimit -c 0; exec \"$0\" \"$@\"")])
            .arg(std::env::current_exe().unwrap())
            .args([test, "--exact", "--nocapture", "--test-threads=1"])
            // One arena per thread would take 64 MiB of address space each.
            .env("MALLOC_ARENA_MAX", "1")
            .env(CHILD, task)
            .env("RUST_BACKTRACE", "0")
            .stdout(Stdio::null())
            .stderr(File::create(&stderr).unwrap())
            .spawn()
            .unwrap();
        let ended = watched(&mut child, desk.path());
        let last = progress(desk.path()).unwrap_or(first);
        if ended != "done" {
            let messages = fs::read_to_string(stderr).unwrap();
            let last_message = messages.trim().rsplit("\n\n").next().unwrap_or_default();
            let kept = keep(target, last);
            findings.push(format!("{} {last}: {ended}: {last_message} ({})", target.name, kept.display()));
        }
        let slow = fs::read_to_string(desk.path().join("findings")).unwrap_or_default();
        findings.extend(slow.lines().map(String::from));
        first = last + 1;
    }
    findings
}

/// Waits until the child ends or hangs. Returns its exit status as text.
fn watched(child: &mut Child, desk: &Path) -> String {
    let (mut latest, mut since) = (None, Instant::now());
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return if status.success() { "done".to_string() } else { status.to_string() };
        }
        let now = progress(desk);
        if now != latest {
            (latest, since) = (now, Instant::now());
        } else if since.elapsed() > HANGS {
            child.kill().unwrap();
            child.wait().unwrap();
            return "hangs".to_string();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn progress(desk: &Path) -> Option<u64> {
    fs::read(desk.join("progress")).ok()?.try_into().ok().map(u64::from_le_bytes)
}

/// Creates a temporary folder, in memory if possible, because every case writes a file.
fn desk() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.unwrap()
}

/// Saves the file of a case in target/findings.
fn keep(target: &Target, case: u64) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/findings");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join(format!("{}-{case}-{}", target.name, target.file));
    fs::write(&path, mutated(target, case)).unwrap();
    path
}

/// Runs the cases of a child process.
fn child(targets: &[Target], task: &str) {
    let [name, first, end, desk] = task.split('\n').collect::<Vec<_>>()[..] else { panic!("{task}") };
    let target = targets.iter().find(|target| target.name == name).unwrap();
    let (file, progress) = (Path::new(desk).join(target.file), File::create(Path::new(desk).join("progress")).unwrap());
    for case in first.parse::<u64>().unwrap()..end.parse().unwrap() {
        progress.write_all_at(&case.to_le_bytes(), 0).unwrap();
        fs::write(&file, mutated(target, case)).unwrap();
        let begun = Instant::now();
        // A panic ends the child, because the state of the reader is unknown afterwards.
        (target.read)(&file);
        let took = begun.elapsed();
        if took > LONGEST {
            let mut findings =
                File::options().create(true).append(true).open(Path::new(desk).join("findings")).unwrap();
            writeln!(findings, "{name} {case}: took {took:?} ({})", keep(target, case).display()).unwrap();
        }
    }
}

/// Pseudo-random numbers from a seed (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number below `end`, which must not be 0.
    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn of<'a, T: ?Sized>(&mut self, choice: &[&'a T]) -> &'a T {
        choice[self.below(choice.len())]
    }
}

/// Numbers at the limits of integer types.
const NUMBERS: [u64; 12] =
    [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, u64::MAX / 2, u64::MAX];
/// Texts that readers often handle wrongly.
const WORDS: [&str; 16] = [
    "-1",
    "0",
    "1e999",
    "-1e-999",
    "NaN",
    "null",
    "true",
    "\"\"",
    "[]",
    "{}",
    "[[[[[[[[",
    "4294967296",
    "9007199254740993",
    "\\u0000",
    ",,,",
    "\u{1F4F7}",
];

/// Returns the file of a case: a file of the corpus with one to six mutations.
fn mutated(target: &Target, case: u64) -> Vec<u8> {
    let name = target.name.bytes().fold(0, |hash: u64, byte| hash.wrapping_mul(31).wrapping_add(byte.into()));
    let mut random = Random(name ^ case.wrapping_mul(0x2545_f491_4f6c_dd1d));
    let mut bytes = target.corpus[random.below(target.corpus.len())].clone();
    for _ in 0..=random.below(6) {
        mutate(&mut bytes, target, &mut random);
    }
    if bytes.starts_with(b"\x89PNG") && random.below(4) > 0 {
        correct_checksums(&mut bytes);
    }
    bytes
}

fn mutate(bytes: &mut Vec<u8>, target: &Target, random: &mut Random) {
    if bytes.is_empty() {
        bytes.push(random.next() as u8);
        return;
    }
    // Half of the mutations are in the first 128 bytes, which hold the headers.
    let reach = if random.below(2) == 0 { bytes.len().min(128) } else { bytes.len() };
    let at = random.below(reach);
    let length = 1 + random.below((bytes.len() - at).min(64));
    match random.below(9) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.next() as u8,
        2 => drop(bytes.drain(at..at + length)),
        3 => drop(bytes.splice(at..at, bytes[at..at + length].to_vec())),
        4 => bytes.truncate(at),
        5 => number(bytes, at, random),
        6 => drop(bytes.splice(at..at, random.of(&WORDS).bytes())),
        7 => word(bytes, at, random),
        _ => {
            let other = &target.corpus[random.below(target.corpus.len())];
            let from = random.below(other.len().max(1)).min(other.len());
            bytes.truncate(at);
            bytes.extend(&other[from..]);
        }
    }
}

/// Writes a number of one to eight bytes, in either byte order.
fn number(bytes: &mut [u8], at: usize, random: &mut Random) {
    let number = NUMBERS[random.below(NUMBERS.len())].wrapping_add(random.below(3) as u64).wrapping_sub(1);
    let size = (1 << random.below(4)).min(bytes.len() - at);
    let big = number.to_be_bytes();
    let written = if random.below(2) == 0 { &number.to_le_bytes()[..size] } else { &big[8 - size..] };
    bytes[at..at + size].copy_from_slice(written);
}

/// Replaces the word that begins at `at`.
fn word(bytes: &mut Vec<u8>, at: usize, random: &mut Random) {
    let is_of_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-._".contains(byte);
    let end = at + bytes[at..].iter().take_while(|byte| is_of_word(byte)).count();
    drop(bytes.splice(at..end, random.of(&WORDS).bytes()));
}

/// Corrects the checksums of the chunks of a PNG, because decoders stop at a wrong checksum.
fn correct_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let end = at + 8 + u32::from_be_bytes(head.try_into().unwrap()) as usize;
        if end.saturating_add(4) > bytes.len() {
            return;
        }
        let mut sum = flate2::Crc::new();
        sum.update(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.sum().to_be_bytes());
        at = end + 4;
    }
}
