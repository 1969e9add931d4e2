//! Tests of the `parfocal` program, one file per subcommand or topic.
//!
//! All files form one test binary because linking each takes long.

#[path = "../common/mod.rs"]
mod common;

mod again;
mod apply;
mod batch;
mod bench;
mod browser;
mod desk;
mod exports;
mod formats;
mod guide;
mod input;
mod inspect;
#[cfg(target_os = "linux")]
mod kills;
mod line;
mod metric;
mod outputs;
mod page;
mod pixel_size;
mod register;
mod repeat;
mod report_html;
mod report_html_sweep;
mod results;
mod roughness;
mod safety;
mod scope;
mod shading;
mod shell;
mod simulate;
mod solve;
mod stack;
mod sweep_results;
mod synthetic;
mod trust;
mod view;
#[cfg(windows)]
mod windows;
