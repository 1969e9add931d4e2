//! Writes results to files and reads them: fields, pictures, the report.
//!
//! [`Results`] are made from a solution or a sweep, written into a folder, and read from it.

mod arrays;
mod destination;
mod folder;
mod fused;
mod golden;
pub(crate) mod image_files;
mod inspection;
mod journal;
mod maps;
mod md5;
mod measurements;
mod registration;
mod repeat;
mod report;
mod results;
mod scale;
mod single;
mod staging;
mod topography;
mod write;
mod zip;

pub use crate::files::bounded_read::{Hash, Hashes, is_whole};
pub(crate) use arrays::write_tiff;
pub use arrays::{ArrayKind, Depth16};
pub use destination::{Destination, FileKind, INSPECT_FILES, REPEAT_FILES, SIMULATED_FILES, check_writable, listed_in};
pub use folder::abandon;
pub use fused::{FUSED_FILE, FUSED_FLOAT_FILE, fused};
pub use golden::{GoldenPart, GoldenReport, TaughtPart, read_golden, write_golden};
pub(crate) use image_files::{SOFTWARE, write_drawing};
pub use inspection::{DeviationReport, InspectReport, InspectedPart, write_inspection};
pub use maps::{MOST_LABELS, labels, sweep_labels};
pub use measurements::{MeasurementRequest, profiles_in};
pub use registration::{
    FrameRegistration, Registration, registered_ending, registered_kind, write_json, write_registered, write_report,
};
pub use repeat::{ReadingReport, RepeatReport, ValueReport, write_repeat};
pub use report::{
    Depth16Report, DepthReport, DeviceReport, FieldReport, FrameReport, Header, Kind, LevelReport, Measurements,
    NearerBy, NeverReport, PIXEL_SIZES_UM, ParallaxReport, ProfileReport, REPORT_FILE, RangeReport, Report,
    ShadingReport, SizeReport, StepReport, SurfaceReport, TextureReport, TimingsReport, to_json,
};
pub(crate) use report::{with_header, write_json_to};
pub use results::{DEPTH_FILE, DEPTH_PICTURE_FILE, Drawing, Extra, PAGE_FILE, Plotter, Results};
pub(crate) use scale::Quantiles;
pub use scale::{Nearer, Palette, Quantity, Scale};
pub(crate) use single::write_file;
pub(crate) use staging::Staging;
pub use staging::write_named;
pub use topography::TopographyKind;
pub use write::result_files;
