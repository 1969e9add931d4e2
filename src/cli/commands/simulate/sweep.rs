//! `parfocal simulate --frames N`: a synthetic focus sweep.

use std::path::{Path, PathBuf};

use parfocal::export::{Destination, SIMULATED_FILES};
use parfocal::internals::scene::{Scene, SweepField, SweepScene, Truth, simulated_sweep_files, write_simulated_sweep};

use crate::cli::options::output::ReportArguments;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;

/// The options of a sweep.
#[derive(clap::Args, Debug)]
pub(crate) struct SweepArguments {
    /// Render a sweep of N frames (3 to 999) instead of a pair
    ///
    /// Frame k, from 0, is focused at setting k. The scene lies between 0.1 and 0.9 of the range of settings.
    #[arg(long, value_name = "N", help_heading = SWEEP)]
    frames: Option<usize>,
    /// c, px² per squared setting: a point in focus at u has the blur c (k - u)² in frame k [default: 36/(N - 1)²]
    #[arg(long, value_name = "PX2", help_heading = SWEEP, requires = "frames", allow_negative_numbers = true)]
    blur_rate: Option<f64>,
    /// Magnification from the first frame to the last (-20 to 20 %) [default: 1]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames", allow_negative_numbers = true)]
    breathing: Option<f64>,
    /// Movement from the first frame to the last, on a smooth path (0 to 1000 px) [default: 2]
    #[arg(long, value_name = "PX", help_heading = SWEEP, requires = "frames", allow_negative_numbers = true)]
    drift: Option<f64>,
    /// Linear drift of the gain to either side of the middle frame (-50 to 50 %) [default: 0]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames", allow_negative_numbers = true)]
    gain_drift: Option<f64>,
    /// Vignetting of the corners in the last frame, with the opposite sign in the first (-50 to 50 %) [default: 0]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames", allow_negative_numbers = true)]
    vignetting: Option<f64>,
}

const SWEEP: &str = "Focus sweep";

/// The default rotation, degrees, like that of a pair.
const ROTATION: f64 = 0.15;

impl SweepArguments {
    /// Whether `--frames` was given.
    pub(crate) fn is_given(&self) -> bool {
        self.frames.is_some()
    }

    /// The requested sweep, if any. `rotation` is in degrees.
    pub(crate) fn of(&self, scene: &Scene, rotation: Option<f64>) -> Option<SweepScene> {
        let sweep = SweepScene::new(scene.clone(), self.frames?);
        Some(SweepScene {
            blur_rate: self.blur_rate.unwrap_or(sweep.blur_rate),
            breathing: self.breathing.unwrap_or(1.0) / 100.0,
            drift: self.drift.unwrap_or(2.0),
            rotation: rotation.unwrap_or(ROTATION).to_radians(),
            gain_drift: self.gain_drift.unwrap_or(0.0) / 100.0,
            vignetting: self.vignetting.unwrap_or(0.0) / 100.0,
            ..sweep
        })
    }
}

/// Renders and writes a sweep.
pub(crate) fn run(
    sweep: &SweepScene,
    out: Destination<'_>,
    inputs: &[&PathBuf],
    report: &ReportArguments,
) -> Result<(), Failure> {
    sweep.check()?;
    let (json, files) = (SIMULATED_FILES[4], simulated_sweep_files(sweep.frames));
    destination::check(out.path(), json, &files.iter().map(String::as_str).collect::<Vec<_>>(), inputs)?;
    out.check_results(json, &files)?;
    let simulated = sweep.render()?;
    let truth = Truth::<SweepField>::new(sweep, &simulated);
    write_simulated_sweep(out, &simulated, &truth)?;
    report.print(&summary(&truth, out.path()), || truth.to_json())
}

fn summary(truth: &Truth<SweepField>, output: &Path) -> String {
    let (first, last) = (&truth.frames[0], &truth.frames[truth.frames.len() - 1]);
    let ends = [first, last].map(|frame| {
        let t = &frame.transform;
        let at = format!("({:.3}, {:.3}) px, {:.4}°, scale {:.5}", t.tx, t.ty, t.rotation_deg(), t.scale);
        format!("{}: T {at}, gain {:.4}", frame.file, frame.exposure.gain)
    });
    let (size, focus) = (truth.size, &truth.field.focus);
    let mut lines = vec![
        format!(
            "{}, {} frames of {}x{} px, seed {}",
            truth.scene,
            truth.frames.len(),
            size.width,
            size.height,
            truth.seed
        ),
        format!("in focus: settings {:.3} to {:.3}", focus.min.unwrap_or(0.0), focus.max.unwrap_or(0.0)),
        format!("blur: {:.4} px² a squared setting from the focus", truth.field.blur_rate_px2),
    ];
    lines.extend(ends);
    if truth.clipped_samples > 0 {
        lines.push(format!(
            "warning: {} samples lay outside 0 to 1 and were clipped: lower --contrast, --gain-drift or --noise",
            truth.clipped_samples
        ));
    }
    lines.push(format!("in {}", output.display()));
    lines.join("\n")
}
