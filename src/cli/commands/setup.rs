//! The subcommands of set-up: `devices`, `config`, `completions` and `man`.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Arg;
use clap::builder::PossibleValue;
use clap_complete::Shell;
use clap_mangen::Man;
use parfocal::export::{FileKind, write_named};
use parfocal::internals::device_check::{self, DeviceCheck};
use parfocal::{Engine, EngineOptions, settings::DeviceInfo};
use serde_json::json;

use crate::cli::help::{is_bool, is_number, takes_config, wrapped};
use crate::cli::options::config_file::is_key;
use crate::cli::options::run::{check_validation, is_validation_requested};
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::{Failure, nearest, print, print_bytes};

/// List the devices and the reasons why some cannot be used
#[derive(clap::Args, Debug)]
pub(crate) struct Devices {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
    /// Print the names of the usable devices only, one per line
    #[arg(short, long, conflicts_with = "json")]
    quiet: bool,
    /// Solve twelve generated inputs on a Vulkan device and on the processor, and compare
    ///
    /// D is as for --device of other commands. Prints the largest difference of each quantity beside what rounding
    /// explains, and the time on both. Fails if a difference is larger, or if the device fails. With --json, for a
    /// report of a bug.
    #[arg(long, value_name = "D", num_args = 0..=1, default_missing_value = "vulkan", conflicts_with = "quiet")]
    test: Option<String>,
}

/// A device as the JSON list states it.
fn entry(info: &DeviceInfo) -> serde_json::Value {
    json!({
        "index": info.index,
        "name": info.name,
        "driver": info.driver,
        "uuid": info.uuid,
        "kind": info.kind,
        "vulkan": info.api_version,
        "subgroup_size": info.subgroup_size,
        "memory_bytes": info.memory_bytes,
        "max_image_size": info.max_image_size,
        "max_storage_buffer_bytes": info.max_storage_buffer,
        "usable": info.unusable.is_none(),
        "why_not": info.unusable,
    })
}

/// Prints the devices, or tests one.
pub(crate) fn devices(arguments: &Devices) -> Result<(), Failure> {
    if let Some(device) = &arguments.test {
        return test(device, arguments.json);
    }
    let devices = Engine::devices()?;
    if arguments.json {
        let entries: Vec<_> = devices.iter().map(entry).collect();
        let text = serde_json::to_string_pretty(&entries).map_err(|e| Failure::Failed(e.to_string()))?;
        return print(&text);
    }
    if arguments.quiet {
        let usable = devices.iter().filter(|info| info.unusable.is_none());
        return print(&usable.map(|info| info.name.clone()).collect::<Vec<_>>().join("\n"));
    }
    print(&devices.iter().map(describe).collect::<Vec<_>>().join("\n"))
}

/// Compares solves on a device with those on the processor.
fn test(device: &str, json: bool) -> Result<(), Failure> {
    let open = |name: &str| {
        let validation = is_validation_requested() && name != "cpu";
        Engine::new(&EngineOptions { device: Some(name.to_string()), validation, ..EngineOptions::default() })
    };
    let (engine, processor) = (open(device)?, open("cpu")?);
    let mut checks = Vec::new();
    if !json {
        print(&describe(engine.info()))?;
    }
    let is_right = device_check::check(&engine, &processor, &mut |check| {
        if !json {
            // A closed pipe ends the program with the next print.
            let _ = print(&line_of(check));
        }
        checks.push(check.clone());
    })?;
    if json {
        let report = json!({ "device": entry(engine.info()), "is_right": is_right, "checks": checks });
        print(&serde_json::to_string_pretty(&report).map_err(|e| Failure::Failed(e.to_string()))?)?;
    }
    check_validation(&engine)?;
    if is_right {
        return Ok(());
    }
    let name = &engine.info().name;
    Err(Failure::Failed(format!(
        "{name} computes other results than the processor: use --device cpu, update the driver, and report it with the output of --json"
    )))
}

/// A line on a check: the differences, each beside the largest that is right if it is larger.
fn line_of(check: &DeviceCheck) -> String {
    let verdict = if check.is_right() { "right" } else { "WRONG" };
    if let Some(error) = &check.error {
        return format!("{verdict}  {}: {error}", check.solve);
    }
    let differences = check.differences.iter().map(|d| {
        if d.found > d.most {
            format!("{} {:.2e} of {:.0e}!", d.of, d.found, d.most)
        } else {
            format!("{} {:.1e}", d.of, d.found)
        }
    });
    let [device, processor] = check.times_ms;
    let all = differences.collect::<Vec<_>>().join("; ");
    format!("{verdict}  {}: {all}; {device:.1} ms, processor {processor:.1} ms", check.solve)
}

fn describe(info: &DeviceInfo) -> String {
    let usable = match &info.unusable {
        None => "usable".to_string(),
        Some(why) => format!("not usable: {why}"),
    };
    let gibibytes = info.memory_bytes as f64 / f64::from(1 << 30);
    [
        format!("{}  {} ({})", info.index, info.name, info.kind),
        if info.api_version.is_empty() {
            info.driver.clone()
        } else {
            format!("driver {}, Vulkan {}, UUID {}", info.driver, info.api_version, info.uuid)
        },
        format!(
            "{gibibytes:.1} GiB, subgroups of {}, images up to {} px a side",
            info.subgroup_size, info.max_image_size
        ),
        usable,
    ]
    .join("\n   ")
}

/// Print the options of a subcommand with their defaults as TOML, for --config.
#[derive(clap::Args, Debug)]
pub(crate) struct Config {
    /// The subcommand: solve, batch, stack or register
    #[arg(value_name = "COMMAND", default_value = "solve")]
    command: String,
}

const HEADER: &str = "\
# Options of parfocal, for --config FILE. Keys are the long options. The command line overrides this file, and this
# file overrides the defaults; --SWITCH=false turns a switch off. Keys of other subcommands are ignored, so that one
# file serves solve, batch, watch, stack and register. Paths are relative to the working folder.";

/// Width of a comment, columns.
const WIDTH: usize = 110;

/// Prints the configuration file.
pub(crate) fn config(arguments: &Config, program: clap::Command) -> Result<(), Failure> {
    let names: Vec<&str> = program.get_subcommands().filter(|c| takes_config(c)).map(clap::Command::get_name).collect();
    let name = arguments.command.as_str();
    if names.contains(&name) {
        return print(&text(program.clone(), name));
    }
    let hint =
        nearest(name, names.iter().copied()).map_or_else(String::new, |other| format!("; did you mean '{other}'?"));
    Err(Failure::Usage(format!("{name} takes no --config; {} do{hint}", names.join(", "))))
}

/// The configuration file for a subcommand.
fn text(mut program: clap::Command, subcommand: &str) -> String {
    program.build();
    let options = program.find_subcommand(subcommand).into_iter().flat_map(clap::Command::get_arguments);
    let mut text = HEADER.to_string();
    for option in options.filter(|option| is_key(option)) {
        // Writing into a string does not fail.
        let _ = write!(text, "\n\n{}{}", comment(option), line(option));
    }
    text
}

fn comment(option: &Arg) -> String {
    let words = option.get_long_help().or(option.get_help()).map(ToString::to_string).unwrap_or_default();
    let sentences: Vec<String> = words
        .split("\n\n")
        .map(|paragraph| paragraph.split_whitespace().collect::<Vec<_>>().join(" "))
        .filter(|paragraph| !paragraph.is_empty())
        .map(|paragraph| if paragraph.ends_with('.') { paragraph } else { paragraph + "." })
        .collect();
    let lines = wrapped(&sentences.join(" "), WIDTH);
    // A line for each value that has a meaning.
    let values: Vec<_> = option.get_possible_values().iter().filter_map(in_words).collect();
    lines.lines().map(str::to_string).chain(values).map(|line| format!("# {line}\n")).collect()
}

/// A value with its meaning.
fn in_words(value: &PossibleValue) -> Option<String> {
    value.get_help().map(|help| format!("  {}: {help}", value.get_name()))
}

/// The key with its default. Without a default it is a comment with a placeholder.
fn line(option: &Arg) -> String {
    let key = option.get_long().unwrap_or_default();
    let values: Vec<String> =
        option.get_default_values().iter().map(|v| literal(option, &v.to_string_lossy())).collect();
    match values.as_slice() {
        [] => match option.get_value_names().unwrap_or_default() {
            names @ [_, _, ..] => {
                let all: Vec<_> = names.iter().map(|name| literal(option, name)).collect();
                format!("# {key} = [{}]", all.join(", "))
            }
            _ => format!("# {key} = {}", literal(option, &placeholder(option))),
        },
        [value] => format!("{key} = {value}"),
        _ => format!("{key} = [{}]", values.join(", ")),
    }
}

fn placeholder(option: &Arg) -> String {
    let name = option.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
    match (is_number(option), is_bool(option)) {
        (true, _) => least(option).unwrap_or("1".to_string()),
        (_, true) => "false".to_string(),
        _ => name.unwrap_or_default(),
    }
}

/// The least number of an option, from the range "(2 to 65536)" or "(px, 0.5 to 8)" of its help.
fn least(option: &Arg) -> Option<String> {
    let help = option.get_help()?.to_string();
    let (before, _) = help.split_once(" to ").filter(|(_, after)| after.contains(')'))?;
    let number = before.rsplit([' ', '(']).next()?;
    number.parse::<f64>().is_ok().then(|| number.to_string())
}

fn literal(option: &Arg, value: &str) -> String {
    if is_number(option) || is_bool(option) { value.to_string() } else { toml::Value::from(value).to_string() }
}

/// Print a completion script for a shell
#[derive(clap::Args, Debug)]
#[command(after_help = COMPLETIONS_HELP)]
pub(crate) struct Completions {
    shell: Shell,
}

const COMPLETIONS_HELP: &str = "\
Examples:
  parfocal completions bash > ~/.local/share/bash-completion/completions/parfocal
  parfocal completions zsh > ~/.zfunc/_parfocal      # with fpath+=~/.zfunc before compinit
  parfocal completions fish > ~/.config/fish/completions/parfocal.fish";

/// Prints the script.
pub(crate) fn completions(arguments: &Completions, mut program: clap::Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, "parfocal", &mut script);
    print_bytes(&script)
}

/// Print the manual page, or write a page for each subcommand
#[derive(clap::Args, Debug)]
#[command(after_help = MAN_HELP)]
pub(crate) struct Manual {
    /// Folder for parfocal.1, parfocal-solve.1 and so on; without it the main page is printed
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArgument,
}

const MAN_HELP: &str = "\
Examples:
  parfocal man -o ~/.local/share/man/man1
  parfocal man | man -l -";

/// Prints or writes the pages.
pub(crate) fn manual(arguments: &Manual, program: clap::Command) -> Result<(), Failure> {
    let mut command = program.disable_help_subcommand(true);
    command.build();
    let Some(folder) = &arguments.output else { return print_bytes(&page(command)?) };
    let out = arguments.force.to(folder);
    destination::check_folder(folder)?;
    // After `build`, the display name of a subcommand is "parfocal-solve" and the like.
    let pages = command.get_subcommands().cloned();
    let pages = pages.map(|sub| (format!("{}.1", sub.get_display_name().unwrap_or(sub.get_name())), sub));
    let all: Vec<_> = std::iter::once(("parfocal.1".to_string(), command.clone())).chain(pages).collect();
    let names: Vec<&String> = all.iter().map(|(name, _)| name).collect();
    out.check_named(FileKind::Manual, &names)?;
    for (name, command) in &all {
        write_named(out, &[(name, FileKind::Manual, &page(command.clone())?)])?;
    }
    print(&all.iter().map(|(name, _)| folder.join(name).display().to_string()).collect::<Vec<_>>().join("\n"))
}

fn page(command: clap::Command) -> Result<Vec<u8>, Failure> {
    let mut page = Vec::new();
    Man::new(command)
        .render(&mut page)
        .map_err(|e| Failure::Failed(format!("the manual page cannot be rendered ({e})")))?;
    Ok(page)
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::fs;

    use clap::FromArgMatches;
    use tempfile::TempDir;

    use crate::cli::Cli;
    use crate::cli::options::config_file;

    fn text(subcommand: &str) -> String {
        super::text(crate::cli::command(), subcommand)
    }

    fn parse(arguments: &[&str]) -> String {
        let arguments = arguments.iter().map(OsString::from).collect();
        let (matches, _) = config_file::matches(&crate::cli::command(), arguments).unwrap();
        format!("{:?}", Cli::from_arg_matches(&matches).unwrap())
    }

    #[test]
    fn a_file_with_the_defaults_changes_nothing() {
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("defaults.toml");
        let file = file.to_str().unwrap();
        let cases = [
            ("solve", &["parfocal", "solve", "a", "b", "-o", "out"][..]),
            ("solve", &["parfocal", "register", "a", "b"]),
            ("register", &["parfocal", "register", "a", "b"]),
            ("batch", &["parfocal", "batch", "a", "-o", "out"]),
            ("stack", &["parfocal", "stack", "a", "b", "c", "-o", "out"]),
        ];
        for (of, base) in cases {
            fs::write(file, text(of)).unwrap();
            let with = parse(&[base, &["--config", file]].concat());
            let plain = parse(base).replace("config: None", &format!("config: Some({file:?})"));
            assert_eq!(with, plain);
        }
    }

    #[test]
    fn each_option_is_printed_with_a_comment() {
        assert!(text("stack").contains("\n# focus-at = \"MM,MM,...|START:STEP\"\n"), "{}", text("stack"));
        assert!(text("batch").contains("\nresume = false\n"), "{}", text("batch"));
        let text = text("solve");
        for part in [
            "\nlevels = \"auto\"\n",
            "\nregularization = \"auto\"\n",
            "\nover-relaxation = 1.3\n",
            "\nhold = false\n",
            "\n# transform = \"FILE\"\n",
            "\n# Registration method.\n#   unified: Registration together with the blur",
            "by the focus distances of the lens]. Determines which",
            "\n# gain = 0.001\n",
            "\nedges = \"on\"\n",
            "\n# step = [\"X,Y,W,H\", \"X,Y,W,H\"]\n",
        ] {
            assert!(text.contains(part), "{part:?} is missing in\n{text}");
        }
        assert!(text.lines().all(|line| line.len() <= 120), "{text}");
    }

    #[test]
    fn commented_keys_are_valid_toml_and_their_numbers_are_in_range() {
        let command = crate::cli::command();
        for (name, files) in [("solve", &["a", "b"][..]), ("batch", &["a"]), ("stack", &["a", "b", "c"])] {
            let text = text(name);
            let given = text.lines().filter_map(|line| line.strip_prefix("# ")).filter(|line| line.contains(" = "));
            for line in given {
                let table = toml::from_str::<toml::Table>(line).unwrap();
                let (key, value) = table.iter().next().unwrap();
                if value.is_str() || value.is_array() {
                    continue;
                }
                let flag = format!("--{key}={value}");
                let all = [&["parfocal", name], files, &["-o", "out", &flag]].concat();
                // Some options need others beside them.
                if let Err(error) = command.clone().try_get_matches_from(all) {
                    assert_ne!(error.kind(), clap::error::ErrorKind::ValueValidation, "{line}: {error}");
                }
            }
        }
    }
}
