//! Synthetic photographs and results, which no solve has made.

use std::fs;
use std::path::Path;

use parfocal::export::{Nearer, Report};
use parfocal::{Region, Settings, Solution, results::Findings, settings::DeviceInfo};

use crate::desk::Desk;

/// Options of the lens of the Cup pair.
pub const CUP_LENS: [&str; 5] =
    ["--focal-length=25", "--f-number=8.3", "--pixel-pitch=0.01304", "--focus=529,869", "--telecentric"];

/// Options of a lens whose depth range covers the V of small synthetic pairs.
pub const WIDE_LENS: [&str; 5] =
    ["--focal-length=25", "--f-number=4", "--pixel-pitch=0.013", "--focus=500,900", "--telecentric"];

/// Returns the light of a texture of long and short waves, from -3 to 3.
pub fn waves(x: u32, y: u32) -> f64 {
    let (x, y) = (f64::from(x), f64::from(y));
    (0.9 * x + 0.2 * y).sin() + (0.3 * x - 0.8 * y).cos() + (0.1 * x * y / 20.0).sin()
}

/// Returns the light of waves of many directions, about 0 to 1, blurred by a Gaussian of variance `v` px².
pub fn blurred_waves(x: u32, y: u32, v: f64) -> f64 {
    let waves = (0..40).map(|i| {
        let (angle, k) = (f64::from(i) * 2.399, 0.25 + 0.035 * f64::from(i));
        let phase = k * (f64::from(x) * angle.cos() + f64::from(y) * angle.sin()) + f64::from(i * i);
        (-v * k * k / 2.0).exp() * phase.sin()
    });
    (0.5 + 0.05 * waves.sum::<f64>()).clamp(0.0, 1.0)
}

/// Writes the results of a pair that later commands read: V, its deviation and the report.
///
/// `nearer` is the image focused nearer, 1 or 2.
pub fn write_pair(
    desk: &Desk,
    folder: &str,
    size: (usize, usize),
    nearer: u8,
    [blur, deviation]: [&(dyn Fn(usize, usize) -> f32 + Sync); 2],
) {
    let out = desk.path(folder);
    fs::create_dir_all(&out).unwrap();
    write_field(&out.join("relative_blur.exr"), size, blur);
    write_field(&out.join("uncertainty.exr"), size, deviation);
    desk.write(&format!("{folder}/report.json"), report_of_pair(size, nearer).to_string());
}

/// Writes an EXR file with one channel.
pub fn write_field(file: &Path, size: (usize, usize), value: impl Fn(usize, usize) -> f32 + Sync) {
    use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage};
    let channels = SpecificChannels::build().with_channel("Y").with_pixel_fn(|Vec2(x, y)| (value(x, y),));
    let layer = Layer::new(size, LayerAttributes::default(), Encoding::SMALL_FAST_LOSSLESS, channels);
    Image::from_layer(layer).write().to_file(file).unwrap();
}

/// Returns the report of a pair of this size with identity transform. `nearer` is the image focused nearer, 1 or 2.
pub fn report_of_pair((width, height): (usize, usize), nearer: u8) -> serde_json::Value {
    let [width, height] = [width, height].map(|side| side as u32);
    let findings = Findings {
        width,
        height,
        photograph: [width, height],
        solved: Region { x: 0, y: 0, width, height },
        regularization: 0.003,
        max_relative_blur: 144.0,
        converged: true,
        valid_fraction: 1.0,
        mean_confidence: 0.5,
        clipped_fractions: [0.02, 0.0],
        noise: 0.0025,
        ..Findings::default()
    };
    let solution = Solution { findings, ..Solution::default() };
    let device = DeviceInfo { name: "a device".to_string(), driver: "a driver".to_string(), ..DeviceInfo::default() };
    let nearer = if nearer == 1 { Nearer::First } else { Nearer::Second };
    let mut report = Report::pair(&solution, &Settings::default(), &device, nearer);
    report.texture = None;
    serde_json::to_value(report).unwrap()
}
