//! `parfocal config`: what `--config` reads, with every default.

use std::fmt::Write;

use clap::{Arg, ArgAction, CommandFactory};

use super::Cli;
use super::config::{is_bool, is_key, is_number};
use super::failure::{Failure, print};

/// Print the options of `solve` with their defaults as TOML, for --config.
#[derive(clap::Args, Debug)]
pub(super) struct Arguments {}

const HEADER: &str = "\
# Options of parfocal, for --config FILE: the keys are the long options. What the command line states goes before what
# this file states, and that before the defaults. A key that the subcommand at hand lacks but another one has is left
# out, so that one file serves solve, register and batch. Paths are relative to the working folder.";

/// Columns of a comment.
const WIDTH: usize = 110;

/// Prints the file.
pub(super) fn run(_: &Arguments) -> Result<(), Failure> {
    print(&text("solve"))
}

/// The file for a subcommand.
fn text(subcommand: &str) -> String {
    let mut command = Cli::command();
    command.build();
    let options = command.find_subcommand(subcommand).into_iter().flat_map(clap::Command::get_arguments);
    let mut text = HEADER.to_string();
    for option in options.filter(|option| is_key(option)) {
        // Writing into a string does not fail.
        let _ = write!(text, "\n\n{}{}", comment(option), line(option));
    }
    text
}

fn comment(option: &Arg) -> String {
    let mut words = option.get_help().map(ToString::to_string).unwrap_or_default();
    let names: Vec<_> = option.get_possible_values().iter().map(|v| v.get_name().to_string()).collect();
    let is_switch = matches!(option.get_action(), ArgAction::SetTrue);
    if !names.is_empty() && !is_switch {
        words = format!("{words} ({})", names.join(", "));
    }
    let mut lines = vec![String::new()];
    for word in words.split_whitespace() {
        match lines.last_mut() {
            Some(last) if last.len() + word.len() < WIDTH => last.extend([" ", word]),
            _ => lines.push(format!(" {word}")),
        }
    }
    lines.iter().map(|line| format!("#{line}\n")).collect()
}

/// The default; where there is none, a comment that says what could stand there.
fn line(option: &Arg) -> String {
    let key = option.get_long().unwrap_or_default();
    if matches!(option.get_action(), ArgAction::SetTrue) {
        return format!("{key} = false");
    }
    let values: Vec<String> =
        option.get_default_values().iter().map(|v| literal(option, &v.to_string_lossy())).collect();
    match values.as_slice() {
        [] => format!("# {key} = {}", literal(option, &placeholder(option))),
        [value] => format!("{key} = {value}"),
        _ => format!("{key} = [{}]", values.join(", ")),
    }
}

fn placeholder(option: &Arg) -> String {
    let name = option.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
    match (is_number(option), is_bool(option)) {
        (true, _) => "0".to_string(),
        (_, true) => "false".to_string(),
        _ => name.unwrap_or_default(),
    }
}

fn literal(option: &Arg, value: &str) -> String {
    if is_number(option) || is_bool(option) { value.to_string() } else { toml::Value::from(value).to_string() }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::fs;

    use clap::FromArgMatches;
    use tempfile::TempDir;

    use super::*;
    use crate::cli::config;

    fn parse(arguments: &[&str]) -> String {
        let arguments = arguments.iter().map(OsString::from).collect();
        let (matches, _) = config::matches(&Cli::command(), arguments).unwrap();
        format!("{:?}", Cli::from_arg_matches(&matches).unwrap())
    }

    #[test]
    fn the_defaults_fed_back_change_nothing() {
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("defaults.toml");
        fs::write(&file, text("solve")).unwrap();
        let file = file.to_str().unwrap();
        for base in [&["parfocal", "solve", "a", "b", "-o", "out"][..], &["parfocal", "register", "a", "b"]] {
            let with = parse(&[base, &["--config", file]].concat());
            let plain = parse(base).replace("config: None", &format!("config: Some({file:?})"));
            assert_eq!(with, plain);
        }
    }

    #[test]
    fn every_option_stands_there_with_a_comment() {
        let text = text("solve");
        for part in [
            "\nlevels = \"auto\"\n",
            "\nregularization = 0.003\n",
            "\nover-relaxation = 1.8\n",
            "\nhold = false\n",
            "\n# transform = \"FILE\"\n",
            "(unified, aligned, appearance, sift)",
        ] {
            assert!(text.contains(part), "{part:?} is missing in\n{text}");
        }
        assert!(text.lines().all(|line| line.len() <= 120), "{text}");
    }

    #[test]
    fn every_commented_key_is_one_that_can_be_given() {
        let given: String = text("solve")
            .lines()
            .filter_map(|line| line.strip_prefix("# "))
            .filter(|l| l.contains(" = "))
            .map(|l| format!("{l}\n"))
            .collect();
        assert!(toml::from_str::<toml::Table>(&given).is_ok(), "{given}");
    }
}
