//! What the frames of a sweep are focused at, in mm, and which end of it is near.

use parfocal::export::Nearer;
use parfocal::sweep::Positions;

use crate::cli::options::headings::INPUT;
use crate::cli::output::failure::Failure;

/// Where each frame is focused.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct PlacesArguments {
    /// The distance from the lens at which each frame is focused, in order; gives depth in mm
    #[arg(long, value_name = "MM,MM,...", help_heading = INPUT, value_delimiter = ',', allow_hyphen_values = true)]
    focus_at: Option<Vec<f64>>,
    /// What --focus-at states are places along the axis, from any origin
    ///
    /// Because a stage moved the camera or the scene, or the lens is telecentric towards the scene: depth is even in them,
    /// not in their inverse.
    #[arg(long, help_heading = INPUT, requires_if("true", "focus_at"))]
    stage: bool,
}

impl PlacesArguments {
    /// What is stated, if anything is.
    pub(crate) fn places(&self) -> Option<Positions> {
        let at = self.focus_at.clone()?;
        Some(if self.stage { Positions::Stage(at) } else { Positions::Distances(at) })
    }
}

/// Which end of the sweep is near, by `--nearer` and by the distances. A stage may count either way, and is overruled.
pub(crate) fn nearer(stated: Option<u8>, positions: &Positions) -> Result<Nearer, Failure> {
    let by_distance = positions.first_is_nearest().map(|first| if first { 1 } else { 2 });
    let contradicted = stated.is_some() && by_distance.is_some() && stated != by_distance;
    if contradicted && matches!(positions, Positions::Distances(_)) {
        return Err(Failure::Usage("--nearer contradicts --focus-at; leave --nearer out".to_string()));
    }
    Ok(if stated.or(by_distance) == Some(2) { Nearer::Second } else { Nearer::First })
}
