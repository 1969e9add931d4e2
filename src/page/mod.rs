//! Pictures of results: plots and keys, the surface in three dimensions, and `report.html`.

pub mod batch_html;
pub mod figure;
pub mod inspection;
pub mod repeat;
pub mod report_html;
pub mod view;
