//! Bounds on the accuracy of the default settings.
//!
//! All solves use the settings of a user who states none, except for an asymmetric kernel, which is stated.

mod edges;
mod photographs;
mod scenes;

use std::path::Path;

use self::scenes::{RATIO, USUAL};
use super::runner::Runner;
use super::section::{Case, Section};
use crate::base::statistics::median;

/// The heading in the report.
pub(super) const HEADING: &str = "Default settings";

/// Measures everything.
pub(super) fn run(runner: &mut Runner, data: &Path) -> Vec<Section> {
    let mut sections = vec![scenes::shading(runner), scenes::noise(runner), scenes::accuracy(runner)];
    let (part, part_smoothness, part_sigma) = photographs::part(runner, data);
    let [mut smoothness, mut sigma] = scenes::smoothness_and_sigma(runner);
    smoothness.extend(part_smoothness);
    let ratios = median(smoothness.iter().filter_map(|case| case.get(RATIO)));
    smoothness.push(Case::new("median").at_most(RATIO, ratios, USUAL));
    let (edges, edges_sigma) = edges::run(runner);
    sigma.extend(edges_sigma);
    sigma.push(part_sigma);
    let what = "Rms of V less the truth, px², by default settings, and by the fixed α that makes it least.";
    sections.push(Section::new("Smoothness", what, smoothness));
    sections.extend([part, photographs::dual_pixel(runner, data), edges]);
    let what = "Shares of the pixels whose error of V is within a multiple of its standard deviation σ.";
    sections.push(Section::new("Sigma", what, sigma));
    // A quick run leaves out some sections.
    sections.retain(|section| !section.cases.is_empty());
    sections
}
