//! What `-h` and `--help` show: one screen of what is needed most, and the subcommands by what they are for.

use std::fmt::Write;

use clap::Command;

use crate::cli::options::config_file::takes_config;

/// What stands below the long help of what runs on a device.
pub(crate) const AFTER_HELP: &str = "\
Exit status: 0 done (a solve that did not converge is done, with warnings, unless --strict), 1 failed, 2 wrong usage.

Environment:
  PARFOCAL_DEVICE=D    the device where --device states none
  PARFOCAL_VALIDATE=1  run under the Khronos validation layer, which must be installed
  PARFOCAL_CACHE_DIR   where compiled pipelines are kept [default: parfocal in $XDG_CACHE_HOME or ~/.cache]
  VK_DRIVER_FILES, VK_ICD_FILENAMES and the other variables of the Vulkan loader work as usual";

/// The subcommands, by what they are for.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Photographs in, depth out", &["solve", "batch", "watch", "stack"]),
    ("Registration alone", &["register", "apply"]),
    ("What to do with a solve", &["open", "view", "depth", "measure", "inspect", "compare", "calibrate"]),
    ("Laboratory", &["simulate", "evaluate", "bench"]),
    ("Set-up", &["devices", "config", "completions", "man", "help"]),
];

/// What `-h` shows of the many options of those subcommands that take `--config`, so that it is one screen.
const NEEDED_MOST: [&str; 23] = [
    "colors",
    "config",
    "crop-valid",
    "decode",
    "device",
    "export",
    "focus-at",
    "help",
    "hold",
    "json",
    "kernel",
    "lens",
    "mask",
    "max-relative-blur",
    "method",
    "nearer",
    "outer-iterations",
    "output",
    "quiet",
    "regularization",
    "resume",
    "roi",
    "transform",
];

/// Columns of `--help`.
pub(crate) const WIDTH: usize = 100;

/// Hides from `-h` what few need, and breaks the lines of `--help`.
pub(crate) fn laid_out(command: Command) -> Command {
    let has_many = takes_config(&command);
    command.mut_args(|option| {
        let is_rare = has_many && option.get_long().is_some_and(|long| !NEEDED_MOST.contains(&long));
        let long = option.get_long_help().or(option.get_help().filter(|_| has_many));
        let long = long.map(|text| wrapped(&text.to_string(), WIDTH - 10));
        let option = if is_rare { option.hide_short_help(true) } else { option };
        match long {
            Some(long) => option.long_help(long),
            None => option,
        }
    })
}

/// A text of which no line is longer than `width`, unless a word is; its paragraphs stay apart.
pub(crate) fn wrapped(text: &str, width: usize) -> String {
    let mut lines: Vec<String> = Vec::new();
    for paragraph in text.lines() {
        lines.push(String::new());
        for word in paragraph.split_whitespace() {
            match lines.last_mut() {
                Some(line) if line.is_empty() => line.push_str(word),
                Some(line) if line.chars().count() + word.chars().count() < width => line.extend([" ", word]),
                _ => lines.push(word.to_string()),
            }
        }
    }
    lines.join("\n")
}

/// Gives the program's own help its subcommands in groups, which clap cannot.
pub(crate) fn with_groups(mut command: Command) -> Command {
    command.build();
    let mut text = String::new();
    for (heading, names) in GROUPS {
        // Writing into a string does not fail.
        let _ = writeln!(text, "{heading}:");
        for subcommand in names.iter().filter_map(|name| command.find_subcommand(name)) {
            let about = subcommand.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {:<12} {about}", subcommand.get_name());
        }
        text.push('\n');
    }
    let template =
        format!("{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{text}Options:\n{{options}}{{after-help}}");
    command.help_template(template)
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use clap::Arg;

    use super::*;
    use crate::cli::options::config_file::is_bool;
    use crate::cli::options::headings::{BLUR, DEVICE, INPUT, OUTPUT, REGION, REGISTRATION};

    fn program() -> Command {
        let mut command = crate::cli::command();
        command.build();
        command
    }

    fn short_help(name: &str) -> String {
        program().find_subcommand_mut(name).unwrap().render_help().to_string()
    }

    #[test]
    fn every_subcommand_stands_in_one_group() {
        let program = program();
        let names: BTreeSet<&str> = program.get_subcommands().map(Command::get_name).collect();
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        assert_eq!(grouped.len(), names.len());
        assert_eq!(grouped.into_iter().collect::<BTreeSet<_>>(), names);
        let help = crate::cli::command().render_help().to_string();
        assert!(names.iter().all(|name| help.contains(&format!("\n  {name} "))), "{help}");
        assert!(help.contains("\nLaboratory:\n  simulate "), "{help}");
    }

    #[test]
    fn short_help_is_one_screen() {
        for name in ["solve", "batch", "stack", "register"] {
            let help = short_help(name);
            assert!(help.lines().count() <= 45, "{}\n{help}", help.lines().count());
            assert!(help.lines().all(|line| line.chars().count() <= 120), "{help}");
        }
        let (help, program) = (short_help("solve"), program());
        for heading in [INPUT, REGISTRATION, BLUR, REGION, OUTPUT, DEVICE] {
            assert!(help.contains(&format!("\n{heading}:\n")), "{heading} is missing in\n{help}");
        }
        let options: BTreeSet<_> =
            program.get_subcommands().flat_map(Command::get_arguments).filter_map(Arg::get_long).collect();
        assert!(NEEDED_MOST.iter().all(|name| options.contains(name)));
    }

    #[test]
    fn one_name_has_one_meaning() {
        // These name a file in one place and a folder in another, or allow more in one than in another.
        let alike = ["output", "kernel", "help", "version"];
        let mut meanings: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for command in program().get_subcommands() {
            for option in command.get_arguments().filter(|a| a.get_long().is_some_and(|long| !alike.contains(&long))) {
                let values = if is_bool(option) { &[] } else { option.get_value_names().unwrap_or_default() };
                meanings.entry(option.get_long().unwrap().to_string()).or_default().insert(format!("{values:?}"));
            }
        }
        let several: Vec<_> = meanings.iter().filter(|(_, values)| values.len() > 1).collect();
        assert!(several.is_empty(), "{several:#?}");
    }

    #[test]
    fn a_long_line_is_broken_between_words() {
        assert_eq!(wrapped("one two three\n\nfour", 8), "one two\nthree\n\nfour");
        assert_eq!(wrapped("unbreakable", 3), "unbreakable");
    }
}
