//! The headings under which help lists options, as every subcommand has them.

pub(crate) const INPUT: &str = "Input";
pub(crate) const REGISTRATION: &str = "Registration";
pub(crate) const BLUR: &str = "Relative blur V";
pub(crate) const REGION: &str = "Region";
pub(crate) const LENS: &str = "Lens";
pub(crate) const MEASUREMENTS: &str = "Measurements";
pub(crate) const OUTPUT: &str = "Output";
pub(crate) const DEVICE: &str = "Device";
