//! The subcommands, one a file.

pub(crate) mod apply;
pub(crate) mod batch;
pub(crate) mod bench;
pub(crate) mod calibrate;
pub(crate) mod compare;
pub(crate) mod config;
pub(crate) mod depth;
pub(crate) mod devices;
pub(crate) mod evaluate;
pub(crate) mod inspect;
pub(crate) mod measure;
pub(crate) mod open;
pub(crate) mod register;
pub(crate) mod shell;
pub(crate) mod simulate;
pub(crate) mod solve;
pub(crate) mod stack;
pub(crate) mod view;
pub(crate) mod watch;
