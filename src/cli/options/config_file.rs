//! `--config FILE`: a TOML file whose keys are the long options without their dashes.
//!
//! Options of the file are inserted before the arguments of the command line. So the same parser checks both, and each
//! option is a key.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue};
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use parfocal::internals::bounded_read;
use toml::{Spanned, Value};

use crate::cli::help::{INPUT, is_bool, is_number, takes_config};
use crate::cli::output::failure::{self, Failure, nearest};

/// Greatest number of bytes that are read, 1 MiB.
const MAX_BYTES: u64 = 1 << 20;

/// `--config`, for the subcommands that take it.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct ConfigArgument {
    /// Options from a TOML file, as `parfocal config` prints one; the command line overrides them
    #[arg(long, value_name = "FILE.toml", help_heading = INPUT)]
    config: Option<PathBuf>,
}

impl ConfigArgument {
    /// The file, if `--config` was given.
    pub(crate) fn file(&self) -> Option<&PathBuf> {
        self.config.as_ref()
    }
}

/// The lines of the options in a file, for error messages.
#[derive(Debug, Default)]
pub(crate) struct Origin {
    file: PathBuf,
    /// Key and line of each option that was used.
    used: Vec<(String, usize)>,
}

impl Origin {
    /// Adds file and line to an error message that begins with the name of an option from the file.
    pub(crate) fn locate(&self, failure: Failure) -> Failure {
        let Failure::Usage(message) = failure else { return failure };
        let begins = |key: &str| message.starts_with(&format!("--{key} is "));
        match self.used.iter().find(|(key, _)| begins(key)) {
            Some((_, line)) => Failure::Usage(format!("{}:{line}: {message}", self.file.display())),
            None => Failure::Usage(message),
        }
    }
}

/// One line of the file.
#[derive(Debug)]
struct Entry {
    key: String,
    value: Value,
    line: usize,
}

/// Parses the command line together with the file of `--config`. Like `Command::get_matches_from`, it ends the program
/// if the arguments have an error.
pub(crate) fn matches(command: &Command, arguments: Vec<OsString>) -> Result<(ArgMatches, Origin), Failure> {
    let Some((given, name, file)) = requested(command, &arguments) else {
        let matches = command.clone().try_get_matches_from(arguments);
        return Ok((matches.unwrap_or_else(|error| failure::exit(error)), Origin::default()));
    };
    let wrap = |problem: String| Failure::Usage(problem);
    let mut built = command.clone();
    built.build();
    let mut injected = Vec::new();
    let mut origin = Origin { file: file.clone(), used: Vec::new() };
    for entry in read(&file)? {
        let at = |problem: String| wrap(format!("{}:{}: {problem}", file.display(), entry.line));
        let option = find(&built, &name, &entry.key).map_err(at)?;
        let Some(option) = option else { continue };
        if given.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine) {
            continue;
        }
        injected.extend(as_arguments(option, &entry).map_err(at)?);
        origin.used.push((entry.key, entry.line));
    }
    let mut all = arguments;
    let place = all.iter().position(|a| a == OsStr::new(&name)).map_or(all.len(), |i| i + 1);
    all.splice(place..place, injected);
    match command.clone().try_get_matches_from(all) {
        Ok(matches) => Ok((matches, origin)),
        Err(error) => Err(origin.blame(&error).unwrap_or_else(|| failure::exit(error))),
    }
}

impl Origin {
    /// The failure, if clap refuses an argument that comes from the file.
    fn blame(&self, error: &clap::Error) -> Option<Failure> {
        let Some(ContextValue::String(argument)) = error.get(ContextKind::InvalidArg) else { return None };
        let name = argument.trim_start_matches('-').split([' ', '=']).next()?;
        let (_, line) = self.used.iter().find(|(key, _)| key == name)?;
        let text = error.render().to_string();
        let lines =
            text.lines().map(str::trim).take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For "));
        let message = lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
        let message = message.trim_start_matches("error: ");
        Some(Failure::Usage(format!("{}:{line}: {message}", self.file.display())))
    }
}

/// The arguments and name of the subcommand, and the file of `--config`.
fn requested(command: &Command, arguments: &[OsString]) -> Option<(ArgMatches, String, PathBuf)> {
    // Other errors are reported after the file is read.
    let matches = command.clone().ignore_errors(true).try_get_matches_from(arguments).ok()?;
    let (name, given) = matches.subcommand()?;
    let file = given.try_get_one::<PathBuf>("config").ok()??.clone();
    Some((given.clone(), name.to_string(), file))
}

fn read(file: &Path) -> Result<Vec<Entry>, Failure> {
    let failed = |problem: String| Failure::file(file, problem);
    let text = bounded_read::text(file, MAX_BYTES).map_err(|e| match e.kind() {
        ErrorKind::FileTooLarge => {
            failed("is larger than 1 MiB, too large for a configuration; `parfocal config` prints one".to_string())
        }
        _ => failed(format!("cannot be read as a configuration ({e}){}", failure::did_you_mean(file))),
    })?;
    parse(&text).map_err(|(line, problem)| Failure::Usage(format!("{}:{line}: {problem}", file.display())))
}

/// Reads a file, for fuzz tests.
#[cfg(test)]
pub(crate) fn reads(file: &Path) {
    let _ = read(file);
}

fn parse(text: &str) -> Result<Vec<Entry>, (usize, String)> {
    let line = |offset: usize| 1 + text[..offset.min(text.len())].matches('\n').count();
    let entries: BTreeMap<Spanned<String>, Spanned<Value>> = toml::from_str(text)
        .map_err(|e| (line(e.span().map_or(0, |s| s.start)), format!("is not TOML ({})", e.message())))?;
    let mut entries: Vec<Entry> = entries
        .into_iter()
        .map(|(key, value)| {
            let line = line(key.span().start);
            Entry { key: key.into_inner().replace('_', "-"), value: value.into_inner(), line }
        })
        .collect();
    entries.sort_by_key(|entry| entry.line);
    Ok(entries)
}

/// Makes a subcommand with `--config` accept `--switch=false`, which turns off a switch of the file.
pub(crate) fn with_optional_switches(command: Command) -> Command {
    if !takes_config(&command) {
        return command;
    }
    command.mut_args(|option| match option.get_action() {
        ArgAction::SetTrue if option.get_long().is_some() => option
            .action(ArgAction::Set)
            .value_parser(clap::value_parser!(bool))
            .num_args(0..=1)
            .require_equals(true)
            .value_name("BOOL")
            .default_value("false")
            .default_missing_value("true")
            .hide_default_value(true)
            .hide_possible_values(true),
        _ => option,
    })
}

/// Whether an option can be a key of the file.
pub(crate) fn is_key(option: &Arg) -> bool {
    option.get_long().is_some_and(|long| !["config", "help", "version"].contains(&long))
}

/// The option of a subcommand for a key; `None` if the key belongs to another subcommand, since one file can serve
/// several.
fn find<'a>(command: &'a Command, subcommand: &str, key: &str) -> Result<Option<&'a Arg>, String> {
    let takers = || command.get_subcommands().filter(|c| takes_config(c));
    let options = |c: &'a Command| c.get_arguments().filter(|a| is_key(a));
    let own = takers().find(|c| c.get_name() == subcommand).into_iter().flat_map(options);
    if let Some(option) = own.into_iter().find(|a| a.get_long() == Some(key)) {
        return Ok(Some(option));
    }
    if takers().flat_map(options).any(|a| a.get_long() == Some(key)) {
        return Ok(None);
    }
    let names = takers().flat_map(options).filter_map(Arg::get_long);
    let hint = nearest(key, names)
        .map_or_else(|| "`parfocal config` prints all".to_string(), |name| format!("did you mean '{name}'?"));
    Err(format!("there is no option '{key}'; {hint}"))
}

/// The arguments for a key and its value.
fn as_arguments(option: &Arg, entry: &Entry) -> Result<Vec<OsString>, String> {
    let (key, value) = (&entry.key, &entry.value);
    let found = value.type_str();
    match value {
        Value::Boolean(value) if is_bool(option) => return Ok(vec![format!("--{key}={value}").into()]),
        _ if is_bool(option) => return Err(format!("{key} must be true or false, and is {}", article(found))),
        _ => {}
    }
    let Value::Array(values) = value else {
        return Ok(vec![format!("--{key}={}", scalar(option, key, value)?).into()]);
    };
    // Any number of values is given one by one, since the last would take the arguments behind it for more.
    let each = option.get_num_args().map_or(1, |n| if n.max_values() == usize::MAX { 1 } else { n.max_values() });
    let repeated = matches!(option.get_action(), ArgAction::Append);
    // One value that is written with commas, such as a region X,Y,W,H.
    let is_list = option.get_value_names().is_some_and(|names| names.len() == 1 && names[0].contains(','));
    let is_joined = option.get_value_delimiter().is_none() && !repeated && is_list;
    if is_joined && values.is_empty() {
        return Err(format!("{key} must have a value, and is an empty array"));
    }
    if each == 1 && option.get_value_delimiter().is_none() && !repeated && !is_list {
        return Err(format!("{key} must be a single value, and is an array"));
    }
    let texts: Vec<String> = values.iter().map(|v| scalar(option, key, v)).collect::<Result<_, _>>()?;
    if let Some(delimiter) = option.get_value_delimiter().or(is_joined.then_some(',')) {
        let all = texts.join(&delimiter.to_string());
        return Ok(if texts.is_empty() { Vec::new() } else { vec![format!("--{key}={all}").into()] });
    }
    // Options with several values per occurrence, such as --step FROM TO, can also be repeated.
    let occurrence = |values: &[String]| match values {
        [one] => vec![format!("--{key}={one}").into()],
        several => [format!("--{key}")].iter().chain(several).map(OsString::from).collect(),
    };
    Ok(texts.chunks(each).flat_map(occurrence).collect())
}

fn scalar(option: &Arg, key: &str, value: &Value) -> Result<String, String> {
    match value {
        Value::Integer(n) => Ok(n.to_string()),
        Value::Float(x) => Ok(x.to_string()),
        Value::Boolean(is)
            if option.get_possible_values().iter().any(|value| value.matches(&is.to_string(), false)) =>
        {
            Ok(is.to_string())
        }
        Value::String(text) if !is_number(option) => Ok(text.clone()),
        other => {
            let wanted = if is_number(option) { "a number" } else { "a string or a number" };
            Err(format!("{key} must be {wanted}, and is {}", article(other.type_str())))
        }
    }
}

fn article(kind: &str) -> String {
    let article = if kind.starts_with(['a', 'i', 'o']) { "an" } else { "a" };
    format!("{article} {kind}")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;

    /// The options of `solve` with a file and further arguments.
    fn solve(text: &str, extra: &[&str]) -> Result<ArgMatches, String> {
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("c.toml");
        fs::write(&file, text).unwrap();
        let base = ["parfocal", "solve", "a.png", "b.png", "--config", file.to_str().unwrap()];
        let arguments = base.iter().chain(extra).map(OsString::from).collect();
        match matches(&crate::cli::command(), arguments) {
            Ok((found, _)) => Ok(found.subcommand().unwrap().1.clone()),
            Err(Failure::Usage(message)) => Err(message.rsplit_once("c.toml").unwrap().1.to_string()),
            Err(other) => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_command_line_overrides_the_file_which_overrides_the_defaults() {
        let text =
            "output = 'out'\nrelaxation-sweeps = 7\nouter_iterations = 33\nno-photometric = true\nhold = false\n";
        let found = solve(text, &["--relaxation-sweeps", "9"]).unwrap();
        assert_eq!(found.get_one::<u32>("relaxation_sweeps"), Some(&9));
        assert_eq!(found.get_one::<u32>("outer_iterations"), Some(&33));
        assert_eq!(found.get_one::<f64>("over_relaxation"), Some(&1.3));
        assert!(found.get_flag("no_photometric") && !found.get_flag("hold"));
    }

    #[test]
    fn an_error_states_its_line() {
        let cases = [
            (
                "\n\nrelaxation-sweps = 5\n",
                ":3: there is no option 'relaxation-sweps'; did you mean 'relaxation-sweeps'?",
            ),
            ("zzz = 5\n", ":1: there is no option 'zzz'; `parfocal config`"),
            ("# one\nrelaxation-sweeps = 'few'\n", ":2: relaxation-sweeps must be a number, and is a string"),
            ("relaxation-sweeps = true\n", ":1: relaxation-sweeps must be a number, and is a boolean"),
            ("hold = 1\n", ":1: hold must be true or false, and is an integer"),
            ("method = ['sift']\n", ":1: method must be a single value, and is an array"),
            ("[optics]\nx = 1\n", ":1: there is no option 'optics'"),
            ("\nrelaxation-sweeps = = 1\n", ":2: is not TOML"),
            ("relaxation-sweeps = 1\nrelaxation-sweeps = 2\n", ":2: is not TOML"),
            ("\nmethod = 'magic'\n", ":2: invalid value 'magic' for '--method"),
            ("relaxation-sweeps = 1.5\n", ":1: invalid value '1.5' for '--relaxation-sweeps"),
        ];
        for (text, expected) in cases {
            let message = solve(text, &["-o", "out"]).unwrap_err();
            assert!(message.starts_with(expected), "{text:?}: {message}");
        }
    }

    #[test]
    fn the_command_line_can_turn_a_switch_of_the_file_off() {
        let on = |extra: &[&str]| {
            solve("output = 'out'\nno-photometric = true\n", extra).unwrap().get_flag("no_photometric")
        };
        assert!(on(&[]) && on(&["--no-photometric"]) && on(&["--no-photometric=true"]));
        assert!(!on(&["--no-photometric=false"]));
    }

    #[test]
    fn an_option_of_several_values_can_be_repeated() {
        let regions = |text: &str, extra: &[&str]| {
            let found = solve(&format!("output = 'out'\n{text}"), extra);
            found.map(|found| found.get_raw("step").map_or(0, Iterator::count))
        };
        assert_eq!(regions("step = ['0,0,9,9', '9,9,9,9']", &[]), Ok(2));
        assert_eq!(regions("step = ['0,0,9,9', '9,9,9,9', '0,0,8,8', '8,8,8,8']", &[]), Ok(4));
        assert_eq!(regions("step = ['0,0,9,9', '9,9,9,9']", &["--step", "1,1,2,2", "3,3,4,4"]), Ok(2));
        assert!(regions("step = ['0,0,9,9', '9,9,9,9', '0,0,8,8']", &[]).unwrap_err().starts_with(":2: "));
    }

    #[test]
    fn a_value_with_commas_may_be_an_array() {
        let region = |text: &str| {
            solve(&format!("output = 'out'\n{text}"), &[])
                .map(|found| found.get_raw("roi").unwrap().next().unwrap().to_string_lossy().into_owned())
        };
        assert_eq!(region("roi = [8, 9, 40, 30]"), Ok("8,9,40,30".to_string()));
        assert_eq!(region("roi = '8,9,40,30'"), Ok("8,9,40,30".to_string()));
        let edges = solve("output = 'out'\nedges = false\n", &[]).unwrap();
        assert_eq!(edges.get_raw("edges").unwrap().next().unwrap(), "false");
        assert!(region("roi = []").unwrap_err().contains("is an empty array"));
        assert!(region("roi = [8, 9, 40]").unwrap_err().starts_with(":2: invalid value '8,9,40'"));
    }

    #[test]
    fn an_option_of_another_subcommand_is_ignored() {
        assert!(find(&built(), "register", "nearer").unwrap().is_none());
        assert!(find(&built(), "solve", "nearer").unwrap().is_some());
    }

    fn built() -> Command {
        let mut command = crate::cli::command();
        command.build();
        command
    }
}
