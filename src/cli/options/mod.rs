//! The options that subcommands share, and the file of options.

pub(crate) mod colors;
pub(crate) mod config_file;
pub(crate) mod engine;
pub(crate) mod focus_positions;
pub(crate) mod headings;
pub(crate) mod lens;
pub(crate) mod models;
pub(crate) mod output_options;
pub(crate) mod pair;
pub(crate) mod region;
pub(crate) mod results_folder;
pub(crate) mod run;
pub(crate) mod scope;
pub(crate) mod settings;
pub(crate) mod solve_options;
