//! How well focus sweeps are solved: what is demanded of them, measured, by default settings and beside shape from focus; and how sharp the fused image is.

mod flat;
mod fused;
mod generated;
mod simulated;
mod truth;

use std::path::Path;

use super::bench::Bench;
use super::section::Section;

/// Measures everything.
pub(super) fn run(bench: &mut Bench, data: &Path) -> Vec<Section> {
    vec![generated::section(bench, data), simulated::section(bench), flat::section(bench), fused::section(bench, data)]
}

/// The heading in the report.
pub(super) const HEADING: &str = "Sweeps";
