//! `parfocal completions` and `parfocal man`: completion scripts and manual pages.

use std::path::PathBuf;

use clap_complete::Shell;
use clap_mangen::Man;
use parfocal::export::{FileKind, write_named};

use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::{Failure, print, print_bytes};

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
pub(crate) fn completions(arguments: &Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut crate::cli::command(), "parfocal", &mut script);
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
pub(crate) fn manual(arguments: &Manual) -> Result<(), Failure> {
    let mut command = crate::cli::command().disable_help_subcommand(true);
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
        write_named(out, name, FileKind::Manual, &page(command.clone())?)?;
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
