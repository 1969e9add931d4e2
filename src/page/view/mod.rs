//! The surface in three dimensions, textured and colour-coded, as in the paper's Figure 8; still or animated.
//!
//! ```
//! use parfocal::export::Nearer;
//! use parfocal::page::view::{Surface, View};
//! use parfocal::{Frame, page::figure};
//!
//! let bump = |i: usize| 9.0 * (-((i % 64) as f32 - 32.0).powi(2) / 99.0).exp();
//! let blur: Vec<f32> = (0..64 * 48).map(bump).collect();
//! let fused = Frame::gray(64, 48, vec![0.5; 64 * 48]).unwrap();
//! let surface = Surface::new(&blur, &fused, Nearer::First)?;
//! let picture = surface.picture(&View { width: 200, ..View::default() })?;
//! # let folder = tempfile::TempDir::new().unwrap();
//! # let (png, gif) = (folder.path().join("view.png"), folder.path().join("turntable.gif"));
//! figure::write_png(&png, &picture)?;
//! surface.write_turntable(&gif, &View { width: 120, ..View::default() })?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! Heights are nearness, from the 1st to the 99th percentile. They are metric only if the size of a pixel is
//! known. The rasteriser runs on the CPU and gives the same picture on every machine.

mod heights;
mod picture;
mod render;
mod surface;

pub(crate) use heights::Heights;
pub(crate) use surface::relief_to_scale;
pub use surface::{Surface, View};
