//! Tests of the `parfocal` program, one file per subcommand or topic.
//!
//! All files form one test binary because linking each takes long.

#[path = "../common/mod.rs"]
mod common;

use std::path::Path;
use std::process::Output;

use parfocal::export::{Nearer, Report};
use parfocal::{
    Region, Settings, Solution,
    frame::Channels,
    results::{Findings, Timings},
    settings::{DeviceInfo, Photometric},
    transform::{Shading, Similarity},
};

mod again;
mod apply;
mod batch;
mod bench;
mod browser;
mod evaluate;
mod exports;
mod formats;
mod guide;
mod input;
mod inspect;
#[cfg(target_os = "linux")]
mod kills;
mod line;
mod metric;
mod outputs;
mod page;
mod pixel_size;
mod register;
mod repeat;
mod report_html;
mod report_html_sweep;
mod results;
mod roughness;
mod safety;
mod scope;
mod shading;
mod shell;
mod simulate;
mod solve;
mod stack;
mod sweep_results;
mod trust;
mod view;

/// Writes an EXR file with one channel.
fn write_field(file: &Path, size: (usize, usize), value: impl Fn(usize, usize) -> f32 + Sync) {
    use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage};
    let channels = SpecificChannels::build().with_channel("Y").with_pixel_fn(|Vec2(x, y)| (value(x, y),));
    let layer = Layer::new(size, LayerAttributes::default(), Encoding::SMALL_FAST_LOSSLESS, channels);
    Image::from_layer(layer).write().to_file(file).unwrap();
}

/// The program ended with this status, and its message has these parts.
#[track_caller]
fn assert_refused(output: &Output, status: i32, parts: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{stderr}");
    assert!(parts.iter().all(|part| stderr.contains(part)), "{parts:?} in {stderr}");
}

/// Returns the report of a pair of this size with identity transform. `nearer` is the image focused nearer, 1 or 2.
fn report_of_pair(size: [u32; 2], nearer: u8) -> serde_json::Value {
    let [width, height] = size;
    let findings = Findings {
        width,
        height,
        origin: [0, 0],
        photograph: size,
        fused_channels: Channels::Gray,
        transform: Similarity::IDENTITY.into(),
        transform_deviation: None,
        other_motion: None,
        photometric: Photometric::IDENTITY,
        shading: Shading::NONE,
        solved: Region { x: 0, y: 0, width, height },
        regularization: 0.003,
        kernel_shape: None,
        scale_deviation: 0.0,
        levels: Vec::new(),
        converged: true,
        warnings: Vec::new(),
        valid_fraction: 1.0,
        mean_confidence: 0.5,
        saturated_fraction: 0.0,
        clipped_fractions: [0.02, 0.0],
        unsettled_fraction: 0.0,
        unexplained_fraction: 0.0,
        noise: 0.0025,
        timings: Timings::default(),
    };
    let empty = Vec::new;
    let solution = Solution {
        relative_blur: empty(),
        uncertainty: empty(),
        residual: empty(),
        confidence: empty(),
        fused: empty(),
        findings,
    };
    let device = DeviceInfo {
        index: 0,
        name: "a device".to_string(),
        driver: "a driver".to_string(),
        uuid: String::new(),
        kind: "CPU",
        api_version: "1.3.0".to_string(),
        subgroup_size: 8,
        memory_bytes: 1,
        max_image_size: 1,
        max_storage_buffer: 1,
        unusable: None,
    };
    let nearer = if nearer == 1 { Nearer::First } else { Nearer::Second };
    let mut report = Report::pair(&solution, &Settings::default(), &device, nearer);
    report.texture = None;
    serde_json::to_value(report).unwrap()
}
