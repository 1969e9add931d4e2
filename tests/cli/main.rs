//! The program from outside, a file for each subcommand. One test program, since each takes long to link.

#[path = "../common/mod.rs"]
mod common;

mod again;
mod apply;
mod batch;
mod bench;
mod browser;
mod evaluate;
mod formats;
mod guide;
mod input;
mod inspect;
#[cfg(target_os = "linux")]
mod kills;
mod metric;
mod outputs;
mod page;
mod register;
mod report_html;
mod report_html_sweep;
mod results;
mod safety;
mod scope;
mod shading;
mod shell;
mod simulate;
mod solve;
mod stack;
mod sweep_results;
mod trust;
mod view;
