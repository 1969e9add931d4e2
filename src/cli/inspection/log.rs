//! `--log FILE`: what was decided and why, as JSON lines that are appended.

use std::fs::OpenOptions;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde_json::{Value, json};

use crate::cli::help::OUTPUT;
use crate::cli::inspection::verdict::utc;
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
}

impl LogArgument {
    /// Checks that an existing file is a log, and appends the first line.
    pub(crate) fn start(&self, source: &Path, more: Value) -> Result<Log, Failure> {
        let log = Log { file: self.log.clone() };
        if let Some(file) = &self.log {
            let failed = |problem: String| Failure::Failed(format!("{}: {problem}", file.display()));
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
    /// Appends a line. A failure is a warning, since the verdicts are in batch.json too.
    pub(crate) fn write(&self, event: &str, more: Value) {
        if let (Some(file), Err(e)) = (&self.file, self.append(event, more)) {
            let file = plain(&file.display().to_string());
            let _ = writeln!(io::stderr(), "warning: {file}: cannot be written ({e}); the verdicts are in batch.json");
        }
    }

    fn append(&self, event: &str, more: Value) -> io::Result<()> {
        let Some(file) = &self.file else { return Ok(()) };
        let mut line = json!({ "program": PROGRAM, "event": event, "at": utc(SystemTime::now()) });
        merge(&mut line, more);
        let mut opened = OpenOptions::new().append(true).create(true).open(file)?;
        // One call, so that the lines of two programs do not mix.
        opened.write_all(format!("{line}\n").as_bytes())
    }
}

fn merge(line: &mut Value, more: Value) {
    if let (Some(line), Value::Object(more)) = (line.as_object_mut(), more) {
        line.extend(more);
    }
}

/// Whether lines may be appended to a file: it is missing, empty, no regular file, or begins with a line of a log. Ends
/// a last line that was cut off.
fn is_log(file: &Path) -> io::Result<bool> {
    let found = match file.metadata() {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(true),
        found => found?,
    };
    if !found.is_file() || found.len() == 0 {
        return Ok(!found.is_dir());
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
        let start = || argument.start(Path::new("in"), json!({ "tolerance": 1.0 }));
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
        assert!(LogArgument { log: Some(folder.path().into()) }.start(Path::new("in"), json!({})).is_err());
        LogArgument { log: None }.start(Path::new("in"), json!({})).unwrap().write("part", json!({}));
    }
}
