//! Errors of the program: an exit status, and one line on stderr that begins with "error: ", like clap's.

use std::error::Error as _;
use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use parfocal::{Error, Settings, image_io};

/// The reason why a subcommand failed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Failure {
    /// Wrong usage: status 2.
    Usage(String),
    /// Any other failure: status 1.
    Failed(String),
    /// An inspected part is out of tolerance: status 3. The summary reports it.
    NoGo,
    /// An inspected part cannot be judged: status 4. The summary says why.
    CannotJudge,
    /// Ended by Ctrl-C: status 130, as usual for this signal.
    Interrupted(String),
}

impl Failure {
    /// A failure with a file or folder.
    pub(crate) fn file(path: impl AsRef<Path>, problem: impl Display) -> Self {
        Self::Failed(format!("{}: {problem}", path.as_ref().display()))
    }

    /// The failure of a solve with `first` as its first file. Adds this name to errors about size, since the library
    /// does not know the files.
    pub(crate) fn of_solve(error: Error, first: &Path) -> Self {
        match error {
            Error::TooSmall { .. } | Error::TooLarge { .. } => Self::file(first, error),
            other => other.into(),
        }
    }

    /// The message, in one line.
    pub(crate) fn message(&self) -> String {
        match self {
            Self::Usage(message) | Self::Failed(message) | Self::Interrupted(message) => one_line(message),
            Self::NoGo => "no-go".to_string(),
            Self::CannotJudge => "cannot judge".to_string(),
        }
    }

    /// Prints the message and returns the status.
    pub(crate) fn report(self) -> ExitCode {
        let status = match self {
            Failure::Usage(_) => 2,
            Failure::Failed(_) => 1,
            // The summary reports it.
            Failure::NoGo => return ExitCode::from(3),
            Failure::CannotJudge => return ExitCode::from(4),
            Failure::Interrupted(_) => 130,
        };
        // If stderr is closed, there is no reader.
        let _ = writeln!(io::stderr(), "error: {}", self.message());
        ExitCode::from(status)
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let mut message = match &error {
            Error::Setting { name, value, range } => format!("{} is {value}, and must be {range}", option_of(name)),
            other => other.to_string(),
        };
        let mut source = error.source();
        while let Some(cause) = source {
            message = format!("{message}: {cause}");
            source = cause.source();
        }
        match error {
            Error::Setting { .. } => Self::Usage(message),
            _ => Self::Failed(message),
        }
    }
}

/// The name of a setting on the command line.
fn option_of(name: &str) -> String {
    match name {
        "the gain of start_photometric" => "--gain".to_string(),
        "the offset of start_photometric" => "--offset".to_string(),
        _ if Settings::TABLE.iter().any(|setting| setting.name == name) => format!("--{}", name.replace('_', "-")),
        _ => name.to_string(),
    }
}

/// Ends the program like clap: help goes to stdout, errors of the arguments go to stderr.
pub(crate) fn exit(error: clap::Error) -> ! {
    if error.use_stderr() {
        let _ = io::stderr().write_all(in_lines(error).as_bytes());
        std::process::exit(2);
    }
    error.exit()
}

/// The message of clap, with control characters of the arguments escaped.
fn in_lines(mut error: clap::Error) -> String {
    add_hints(&mut error);
    let typed = error.context().filter_map(|(kind, value)| match value {
        ContextValue::String(text) => Some((kind, ContextValue::String(plain(text)))),
        ContextValue::StyledStrs(hints) => {
            Some((kind, ContextValue::StyledStrs(hints.iter().map(|hint| plain(&hint.to_string()).into()).collect())))
        }
        _ => None,
    });
    for (kind, value) in typed.collect::<Vec<_>>() {
        error.insert(kind, value);
    }
    // Value parsers and the usage quote arguments too.
    error.render().to_string().split('\n').map(plain).collect::<Vec<_>>().join("\n")
}

/// Names of options in other programs, and the options.
const SYNONYMS: [(&str, &str); 14] = [
    ("--max-blur", "--max-relative-blur"),
    ("--blur", "--max-relative-blur"),
    ("--smoothness", "--regularization"),
    ("--smooth", "--regularization"),
    ("--alpha", "--regularization"),
    ("--iterations", "--outer-iterations"),
    ("--gpu", "--device"),
    ("--out", "--output"),
    ("--gamma", "--decode"),
    ("--aperture", "--f-number"),
    ("--pixel-size", "--pixel-pitch"),
    ("--crop", "--roi"),
    ("--format", "--export"),
    ("--verbose", "--json"),
];

/// Adds hints that clap lacks, for other names of options and for the decimal comma.
fn add_hints(error: &mut clap::Error) {
    fn text(error: &clap::Error, kind: ContextKind) -> Option<String> {
        if let Some(ContextValue::String(text)) = error.get(kind) { Some(text.clone()) } else { None }
    }
    if error.kind() == ErrorKind::UnknownArgument {
        let typed = text(error, ContextKind::InvalidArg).unwrap_or_default();
        let name = typed.split('=').next().unwrap_or_default();
        if let Some((_, meant)) = SYNONYMS.iter().find(|(other, _)| *other == name) {
            error.insert(ContextKind::SuggestedArg, ContextValue::String((*meant).to_string()));
        }
    }
    let number = text(error, ContextKind::InvalidValue).filter(|value| value.matches(',').count() == 1);
    let with_point = number.map(|value| value.replace(',', ".")).filter(|value| value.parse::<f64>().is_ok());
    if let (ErrorKind::ValueValidation, Some(meant)) = (error.kind(), with_point) {
        let hint = format!("did you mean {meant}? Decimals are written with a point");
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![hint.into()]));
    }
}

/// Joins the lines of a message, since paths and decoder messages may contain line breaks.
fn one_line(message: &str) -> String {
    let parts: Vec<&str> = message.split(['\n', '\r']).map(str::trim).filter(|part| !part.is_empty()).collect();
    plain(&parts.join(" "))
}

/// Escapes control characters and changes of the writing direction in text from outside, such as file names.
pub(crate) fn plain(text: &str) -> String {
    let is_harmful = |c: char| {
        c.is_control() || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        if is_harmful(c) { plain.extend(c.escape_default()) } else { plain.push(c) }
    }
    plain
}

/// The name that is most similar to a misspelt one, if any is similar.
pub(crate) fn nearest<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let scored = names.map(|other| (strsim::normalized_damerau_levenshtein(name, other), other));
    scored.filter(|(score, _)| *score > 0.7).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, other)| other)
}

/// The text "; did you mean 'x'?" if the folder of a missing file has a file with a similar name, else "".
pub(crate) fn did_you_mean(file: &Path) -> String {
    image_io::similar_file(file).map_or_else(String::new, |other| format!("; did you mean '{}'?", other.display()))
}

/// Prints text to stdout. It is not a failure if a reader closes the pipe.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    print_bytes(format!("{text}\n").as_bytes())
}

/// Prints bytes to stdout.
pub(crate) fn print_bytes(bytes: &[u8]) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::Failed(format!("stdout cannot be written ({e})")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_line() {
        assert_eq!(one_line("a\n  b\r\n\nc"), "a b c");
    }

    #[test]
    fn names_from_outside_cannot_control_the_terminal() {
        assert_eq!(one_line("a\x1b[2J\u{9b}1m\tb\u{202e}"), "a\\u{1b}[2J\\u{9b}1m\\tb\\u{202e}");
        assert_eq!(plain("größe µm\n"), "größe µm\\n");
    }

    #[test]
    fn only_a_similar_name_is_suggested() {
        assert_eq!(nearest("sweps", ["levels", "sweeps"].into_iter()), Some("sweeps"));
        assert_eq!(nearest("zzz", ["levels", "sweeps"].into_iter()), None);
        assert_eq!(nearest("exposure", ["export", "resume"].into_iter()), None);
    }

    #[test]
    fn errors_about_size_name_the_file_and_settings_are_usage() {
        let small = Error::TooSmall { width: 5, height: 5, least: 16 };
        let Failure::Failed(message) = Failure::of_solve(small, Path::new("i1.png")) else { panic!("usage") };
        assert!(message.starts_with("i1.png: 5x5"), "{message}");
        let setting = Error::Setting { name: "levels", value: 99.0, range: "1 to 12".to_string() };
        assert_eq!(Failure::from(setting), Failure::Usage("--levels is 99, and must be 1 to 12".to_string()));
    }
}
