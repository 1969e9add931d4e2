//! How well focus sweeps are solved: what is demanded of them, measured, by default settings and beside shape from focus.

mod generated;
mod simulated;
mod truth;

use std::path::Path;

use super::bench::Bench;
use super::section::Section;

/// Measures everything.
pub(super) fn run(bench: &mut Bench, data: &Path) -> Vec<Section> {
    vec![generated::section(bench, data), simulated::section(bench)]
}

/// The heading in the report.
pub(super) const HEADING: &str = "Sweeps";
