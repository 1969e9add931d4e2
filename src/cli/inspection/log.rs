//! `--log FILE`: what was decided and why, as JSON lines that are appended.

use std::cell::{Cell, RefCell};
use std::fs::{self, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use parfocal::internals::bounded_read::not_a_path;
use serde_json::{Value, json};

use crate::cli::batch::summary::is_of_batch;
use crate::cli::help::OUTPUT;
use crate::cli::inspection::verdict::utc;
use crate::cli::output::destination::same_file;
use crate::cli::output::failure::{Failure, plain};

/// The option `--log`.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct LogArgument {
    /// Append a JSON line for each pair that was done: what was decided and why
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    log: Option<PathBuf>,
}

/// The value of `program` in each line.
const PROGRAM: &str = "parfocal";

/// Greatest length of the first line of an existing log, bytes.
const MAX_LINE: u64 = 1 << 20;

/// A log. The file is opened for each line, so that it can be rotated.
pub(crate) struct Log {
    file: Option<PathBuf>,
    /// Whether the last line may have been cut off.
    is_torn: Cell<bool>,
    /// The last problem for which a warning was printed.
    problem: RefCell<String>,
}

impl LogArgument {
    /// Checks that an existing file is a log, and appends the first line. Creates the folder of results, in which it
    /// may lie.
    pub(crate) fn start(&self, source: &Path, out: &Path, more: Value) -> Result<Log, Failure> {
        let log = Log { file: self.log.clone(), is_torn: Cell::new(false), problem: RefCell::default() };
        if let Some(file) = &self.log {
            let failed = |problem: String| Failure::file(file, problem);
            if let Some(problem) = not_a_path(file) {
                return Err(failed(problem.to_string()));
            }
            if file == Path::new("-") {
                return Err(Failure::Usage("--log -: lines are appended to a file; give one".to_string()));
            }
            fs::create_dir_all(out).map_err(|e| Failure::file(out, format!("cannot be created ({e})")))?;
            let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if is_of_batch(&name) && same_file(folder, out) {
                return Err(failed("is a result of the batch; give another name for the log".to_string()));
            }
            let is_log =
                is_log(file).map_err(|e| failed(format!("cannot be read ({e}); give another file for the log")))?;
            if !is_log {
                return Err(failed("is there already, and is no log of parfocal; give another name".to_string()));
            }
            let mut line = json!({ "version": env!("CARGO_PKG_VERSION"), "source": source.display().to_string() });
            merge(&mut line, more);
            log.append("start", line).map_err(|e| failed(format!("cannot be written ({e}); give another file")))?;
        }
        Ok(log)
    }
}

impl Log {
    /// Appends a line. A failure is a warning, one for each problem, since the summary has the verdicts too.
    pub(crate) fn write(&self, event: &str, more: Value) {
        let problem = self.append(event, more).err().map_or_else(String::new, |e| e.to_string());
        let Some(file) = self.file.as_ref().filter(|_| self.problem.replace(problem.clone()) != problem) else {
            return;
        };
        if !problem.is_empty() {
            let file = plain(&file.display().to_string());
            let _ = writeln!(io::stderr(), "warning: {file}: cannot be written ({problem}); the summary has all parts");
        }
    }

    fn append(&self, event: &str, more: Value) -> io::Result<()> {
        let Some(file) = &self.file else { return Ok(()) };
        let mut line = json!({ "program": PROGRAM, "event": event, "at": utc(SystemTime::now()) });
        merge(&mut line, more);
        let mut opened = OpenOptions::new().append(true).create(true).open(file)?;
        let end = if self.is_torn.get() { "\n" } else { "" };
        // One call, so that the lines of two programs do not mix.
        let written = opened.write_all(format!("{end}{line}\n").as_bytes());
        self.is_torn.set(written.is_err());
        written
    }
}

fn merge(line: &mut Value, more: Value) {
    if let (Some(line), Value::Object(more)) = (line.as_object_mut(), more) {
        line.extend(more);
    }
}

/// Whether lines may be appended to a file: it is missing, empty, a character device, or begins with a line of a log.
/// Ends a last line that was cut off. Other files such as a pipe are refused, since opening one may wait for a reader.
fn is_log(file: &Path) -> io::Result<bool> {
    let found = match file.metadata() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(true),
        found => found?,
    };
    if !found.is_file() {
        #[cfg(unix)]
        let is_device = std::os::unix::fs::FileTypeExt::is_char_device(&found.file_type());
        #[cfg(not(unix))]
        let is_device = !found.is_dir();
        return Ok(is_device);
    }
    if found.len() == 0 {
        return Ok(true);
    }
    let mut opened = OpenOptions::new().read(true).append(true).open(file)?;
    let mut first = Vec::new();
    BufReader::new(&opened).take(MAX_LINE).read_until(b'\n', &mut first)?;
    let is_own =
        serde_json::from_slice(&first).is_ok_and(|line: Value| line["program"] == PROGRAM && line["event"].is_string());
    if is_own {
        let mut last = [0];
        opened.seek(SeekFrom::End(-1))?;
        opened.read_exact(&mut last)?;
        if last != *b"\n" {
            opened.write_all(b"\n")?;
        }
    }
    Ok(is_own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_appended_to_a_log_and_to_no_other_file() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("log.jsonl");
        let argument = LogArgument { log: Some(file.clone()) };
        let out = folder.path().join("out");
        let start = || argument.start(Path::new("in"), &out, json!({ "tolerance": 1.0 }));
        start().unwrap().write("part", json!({ "name": "a\nb" }));
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, format!("{text}{{\"cut o")).unwrap();
        start().unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        let lines: Vec<Option<Value>> = text.lines().map(|line| serde_json::from_str(line).ok()).collect();
        let events: Vec<_> = lines.iter().map(|line| line.as_ref().map(|line| line["event"].clone())).collect();
        assert_eq!(events, [Some("start".into()), Some("part".into()), None, Some("start".into())]);
        for other in ["my notes\n", "{\"program\": \"other\"}\n"] {
            std::fs::write(&file, other).unwrap();
            let refused = start().err().unwrap().message();
            assert!(refused.contains("log.jsonl: is there already"), "{refused}");
            assert_eq!(std::fs::read_to_string(&file).unwrap(), other);
        }
        let of = |log: Option<PathBuf>| LogArgument { log }.start(Path::new("in"), &out, json!({}));
        for refused in [folder.path().into(), out.join("batch.json"), out.join("verdicts.csv"), "-".into()] {
            assert!(of(Some(refused)).is_err());
        }
        of(Some(out.join("log.jsonl"))).unwrap();
        let log = of(None).unwrap();
        log.write("part", json!({}));
        // The rest of a torn line.
        let log = Log { file: Some(out.join("log.jsonl")), is_torn: Cell::new(true), ..log };
        log.write("part", json!({}));
        log.write("part", json!({}));
        assert_eq!(std::fs::read_to_string(out.join("log.jsonl")).unwrap().matches("\n\n").count(), 1);
    }
}
