//! The layout of help: headings, groups of subcommands, and one screen of the most used options for `-h`.

use std::any::TypeId;
use std::fmt::Write;

use clap::{Arg, Command};

// Headings of the options, the same in every subcommand.
pub(crate) const INPUT: &str = "Input";
pub(crate) const REGISTRATION: &str = "Registration";
pub(crate) const BLUR: &str = "Relative blur V";
pub(crate) const REGION: &str = "Region";
pub(crate) const LENS: &str = "Lens";
pub(crate) const MEASUREMENTS: &str = "Measurements";
pub(crate) const INSPECTION: &str = "Inspection";
pub(crate) const OUTPUT: &str = "Output";
pub(crate) const DEVICE: &str = "Device";

/// The text below the long help of subcommands that run on a device.
pub(crate) const AFTER_HELP: &str = "\
Exit status: 0 done (without --strict also if the solve did not converge), 1 failed, 2 wrong usage.

Environment:
  PARFOCAL_DEVICE=D    default of --device
  PARFOCAL_VALIDATE=1  use the Khronos validation layer, which must be installed
  PARFOCAL_CACHE_DIR   folder of compiled pipelines [default: parfocal in the cache folder of the user]
  VK_DRIVER_FILES, VK_ICD_FILENAMES and the other variables of the Vulkan loader work as usual";

/// The subcommands by purpose.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Photographs in, depth out", &["solve", "batch", "watch", "stack"]),
    ("Registration alone", &["register", "apply"]),
    ("Results of a solve", &["open", "view", "depth", "measure", "roughness", "repeat", "compare", "calibrate"]),
    ("Good parts and bad ones", &["teach", "inspect"]),
    ("Laboratory", &["simulate", "bench"]),
    ("Set-up", &["devices", "config", "completions", "man", "help"]),
];

/// The options in `-h` of subcommands that take `--config` and have more than [`FEW`] options, so that it fits one
/// screen.
const MOST_USED: [&str; 23] = [
    "config",
    "crop-valid",
    "decode",
    "device",
    "export",
    "focus-at",
    "golden",
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

/// The most options that `-h` lists all.
const FEW: usize = 20;

/// Width of `--help`, columns.
pub(crate) const WIDTH: usize = 100;

/// Hides rarely used options from `-h`, wraps the lines of `--help`, and accepts negative numbers.
pub(crate) fn with_layout(command: Command) -> Command {
    let has_many = takes_config(&command) && command.get_arguments().count() > FEW;
    command.mut_args(|option| {
        let is_rare = has_many && option.get_long().is_some_and(|long| !MOST_USED.contains(&long));
        let long = option.get_long_help().or(option.get_help().filter(|_| has_many));
        let long = long.map(|text| wrapped(&text.to_string(), WIDTH - 10));
        let option = if is_rare { option.hide_short_help(true) } else { option };
        let is_signed = is_number(&option);
        let option = option.allow_negative_numbers(is_signed);
        match long {
            Some(long) => option.long_help(long),
            None => option,
        }
    })
}

/// Wraps the paragraphs of a text at `width` columns.
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

/// Lists the subcommands in groups in the help of the program. clap has no such groups.
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

/// Whether a subcommand takes `--config`.
pub(crate) fn takes_config(command: &Command) -> bool {
    command.get_arguments().any(|option| option.get_long() == Some("config"))
}

/// Whether an option takes a number.
pub(crate) fn is_number(option: &Arg) -> bool {
    let parsed = option.get_value_parser().type_id();
    let numbers = [
        TypeId::of::<f64>(),
        TypeId::of::<f32>(),
        TypeId::of::<u64>(),
        TypeId::of::<u32>(),
        TypeId::of::<u8>(),
        TypeId::of::<usize>(),
    ];
    numbers.iter().any(|number| parsed == *number)
}

/// Whether an option takes true or false.
pub(crate) fn is_bool(option: &Arg) -> bool {
    option.get_value_parser().type_id() == TypeId::of::<bool>()
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    fn program() -> Command {
        let mut command = crate::cli::command();
        command.build();
        command
    }

    fn short_help(name: &str) -> String {
        program().find_subcommand_mut(name).unwrap().render_help().to_string()
    }

    #[test]
    fn each_subcommand_is_in_one_group() {
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
        assert!(MOST_USED.iter().all(|name| options.contains(name)));
    }

    #[test]
    fn options_of_one_name_have_one_meaning() {
        // The values of these options differ between subcommands.
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
    fn long_lines_are_wrapped_between_words() {
        assert_eq!(wrapped("one two three\n\nfour", 8), "one two\nthree\n\nfour");
        assert_eq!(wrapped("unbreakable", 3), "unbreakable");
    }
}
