//! The headings under which help lists options, as every subcommand has them.

pub(super) const INPUT: &str = "Input";
pub(super) const REGISTRATION: &str = "Registration";
pub(super) const BLUR: &str = "Relative blur V";
pub(super) const REGION: &str = "Region";
pub(super) const LENS: &str = "Lens";
pub(super) const MEASUREMENTS: &str = "Measurements";
pub(super) const FINE_TUNING: &str = "Fine tuning";
pub(super) const OUTPUT: &str = "Output";
pub(super) const DEVICE: &str = "Device";
