//! Writes results to files and reads them: fields, pictures, the report.
//!
//! [`Results`] are made from a solution or a sweep, written into a folder, and read from it.

mod arrays;
mod depth_picture;
pub(crate) mod description;
mod destination;
pub(crate) mod exr_file;
mod extra;
mod folder;
mod fused;
mod hashes;
mod inspection;
mod journal;
mod labels;
mod measurements;
pub(crate) mod png_file;
mod registration;
mod report;
mod results;
mod scale;
mod single;
mod staging;
#[cfg(test)]
mod tests;
mod write;
mod zip;

pub use arrays::{ArrayKind, Depth16};
pub use depth_picture::Palette;
pub(crate) use description::SOFTWARE;
pub use destination::{Destination, FileKind, INSPECT_FILES, SIMULATED_FILES, check_writable, listed_in};
pub use extra::{Drawing, Extra, PAGE_FILE, Plotter};
pub use folder::abandon;
pub(crate) use fused::color_type;
pub use fused::{FUSED_FILE, FUSED_FLOAT_FILE, fused};
pub use hashes::{Hash, is_whole};
pub use inspection::{DeviationReport, InspectReport, write_inspection};
pub use labels::{MOST_LABELS, labels, sweep_labels};
pub use measurements::{MeasurementRequest, profiles_in};
pub(crate) use png_file::write_drawing;
pub use registration::{
    FrameRegistration, Registration, registered_ending, registered_kind, write_json, write_registered, write_report,
};
pub use report::{
    Depth16Report, DepthReport, DeviceReport, FieldReport, FrameReport, Header, Kind, LevelReport, Measurements,
    NearerBy, NeverReport, ProfileReport, REPORT_FILE, RangeReport, Report, ShadingReport, SizeReport, StepReport,
    SurfaceReport, TextureReport, TimingsReport,
};
pub(crate) use report::{to_json, with_header, write_json_to};
pub use results::{DEPTH_FILE, DEPTH_PICTURE_FILE, Results};
pub(crate) use scale::Quantiles;
pub use scale::{Nearer, Quantity, Scale};
pub(crate) use single::write_file;
pub(crate) use staging::Staging;
pub use staging::write_named;
pub use write::result_files;
