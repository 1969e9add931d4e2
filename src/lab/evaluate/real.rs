//! Table 2: what each system makes of photographs, whose registration nobody knows.

use std::path::Path;

use serde::Serialize;

use super::bench::{Bench, SYSTEMS, settings, unregistered};
use super::cases::RealPair;
use super::errors::energy;
use super::figures::Collector;
use super::system::NONE;
use crate::base::{Kernel, Method, Photometric, Similarity};
use crate::engine::Solution;

/// All systems on one pair of photographs.
#[derive(Serialize)]
pub(super) struct PairResult {
    pub pair: &'static str,
    pub width: u32,
    pub height: u32,
    /// Why the pair could not be read.
    pub failure: Option<String>,
    pub systems: Vec<Estimate>,
}

/// What one system estimates; what there is not is `null`.
#[derive(Serialize)]
pub(super) struct Estimate {
    pub system: &'static str,
    /// Why there is no solution.
    pub failure: Option<String>,
    pub transform: Option<Similarity>,
    pub photometric: Option<Photometric>,
    /// The largest distance of a corner from where the unified method puts it, px.
    pub corner_to_unified_px: Option<f64>,
    /// E per valid pixel.
    pub energy: Option<f64>,
    pub saturated_fraction: Option<f64>,
    pub mean_confidence: Option<f64>,
    pub time_ms: Option<f64>,
    pub converged: Option<bool>,
    pub warnings: Vec<String>,
}

/// Runs every system on every pair.
pub(super) fn run(bench: &mut Bench, data: &Path, pairs: &[RealPair], figures: &mut Collector) -> Vec<PairResult> {
    pairs.iter().map(|pair| one(bench, data, pair, figures)).collect()
}

fn one(bench: &mut Bench, data: &Path, pair: &RealPair, figures: &mut Collector) -> PairResult {
    bench.say(&format!("table 2: {}", pair.name));
    let [i1, i2] = match pair.read(data, bench.quick) {
        Ok(images) => images,
        Err(e) => {
            return PairResult { pair: pair.name, width: 0, height: 0, failure: Some(e), systems: Vec::new() };
        }
    };
    let kernel = Kernel::Gaussian;
    let mut solved = vec![(NONE, bench.solve([&i1, &i2], &unregistered(&kernel)))];
    for system in SYSTEMS {
        solved.push((system.name(), bench.solve([&i1, &i2], &settings(system, &kernel))));
    }
    figures.real(pair, [&i1, &i2], &solved);
    let unified = solved.iter().find(|(name, _)| *name == Method::Unified.name()).and_then(|(_, s)| s.as_ref().ok());
    let systems = solved.iter().map(|(name, solution)| Estimate::new(name, solution, unified)).collect();
    PairResult { pair: pair.name, width: i1.width(), height: i1.height(), failure: None, systems }
}

impl Estimate {
    fn new(system: &'static str, solution: &Result<Solution, String>, unified: Option<&Solution>) -> Self {
        let found = solution.as_ref().ok();
        let corner = |s: &Solution| Some(s.transform.corner_distance(unified?.transform, s.width, s.height));
        Self {
            system,
            failure: solution.as_ref().err().cloned(),
            transform: found.map(|s| s.transform.at_centre()),
            photometric: found.map(|s| s.photometric),
            corner_to_unified_px: found.and_then(corner),
            energy: found.and_then(energy),
            saturated_fraction: found.map(|s| s.saturated_fraction),
            mean_confidence: found.map(|s| s.mean_confidence),
            time_ms: found.map(|s| s.timings.total_ms),
            converged: found.map(|s| s.converged),
            warnings: found.map(|s| s.warnings.clone()).unwrap_or_default(),
        }
    }
}
