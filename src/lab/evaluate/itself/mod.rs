//! Whether the default settings are right by themselves: what was demanded of them, measured.
//!
//! Everything is solved as by a user who states nothing, but for the kernel where it is asymmetric.

mod dual_pixel;
mod edges;
mod part;
mod plane;
mod scenes;
mod truth;
mod weight;

use std::path::Path;

use self::scenes::{RATIO, USUAL};
use super::bench::Bench;
use super::section::{Case, Section};
use crate::base::statistics::median;

/// Measures everything.
pub(super) fn run(bench: &mut Bench, data: &Path) -> Vec<Section> {
    let (shading, noise, accuracy) = (plane::shading(bench), plane::noise(bench), scenes::accuracy(bench));
    let part = part::rows(bench, data);
    let solved = scenes::solve(bench);
    let mut smoothness = scenes::smoothness(&solved);
    smoothness.extend(part.smoothness);
    let ratios = smoothness.iter().flat_map(|case| &case.figures).filter(|f| f.name == RATIO);
    let usual = Case::new("median").at_most(RATIO, median(ratios.filter_map(|f| f.value)), USUAL);
    smoothness.push(usual);
    let (edges, edges_sigma) = edges::rows(bench).into_iter().map(|rows| (rows.accuracy, rows.sigma)).unzip();
    let mut sigma: Vec<Case> = [scenes::sigma(&solved), edges_sigma].concat();
    sigma.push(part.sigma);
    let mut sections = vec![
        shading,
        noise,
        accuracy,
        Section { name: "Smoothness", what: SMOOTHNESS.to_string(), cases: smoothness },
        Section { name: "Part", what: PART.to_string(), cases: vec![part.accuracy] },
        dual_pixel::section(bench, data),
        edges::section(edges),
        Section { name: "Sigma", what: SIGMA.to_string(), cases: sigma },
    ];
    // What a quick run leaves out.
    sections.retain(|section| !section.cases.is_empty());
    sections
}

const SMOOTHNESS: &str = "Rms of V less the truth, px², by default settings, and by the fixed α that makes it least.";

const PART: &str = "A ray-traced part, thin lens, disk blur, occlusion, noise 0.002, another exposure. Depth against V by \
                    a cubic, 24 px along the border left out: root mean square and median of the absolute residual, of \
                    the range of depth.";

const SIGMA: &str = "Shares of the pixels at which V is off by so many of its standard deviations σ.";

/// The heading in the report.
pub(super) const HEADING: &str = "By itself";
