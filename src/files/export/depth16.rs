//! Depth, or V where there is no lens, in 16 bits with a stated scale: for programs that read no EXR.

use std::io::{Cursor, Write};

use png::ColorType;
use serde::Serialize;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray16;
use tiff::tags::Tag;

use super::Extra;
use super::meaning::{Meaning, SOFTWARE};
use super::picture::{self, Stored};
use crate::metric::MetricDepth;
use crate::solve::sweep::Sweep;

/// The names of the files.
pub(super) const DEPTH16_FILES: [&str; 2] = ["depth16.png", "depth16.tiff"];

/// A field in 16 bits: sample 0 where it is not valid, 1 at its least value, 65535 at its greatest, linear in between.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth16 {
    size: (u32, u32),
    samples: Vec<u16>,
    report: Depth16Report,
}

/// What the samples mean, for `report.json` and for the files themselves: `offset + scale * sample` in `unit`, unless the
/// sample is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Depth16Report {
    /// "depth", "relative_blur", or "focus".
    pub quantity: &'static str,
    /// "mm", "px^2", or what focus is in.
    pub unit: &'static str,
    /// Of one step of the samples, in `unit`.
    pub scale: f64,
    /// The value that the sample 0 would have.
    pub offset: f64,
}

impl Depth16 {
    /// Of V, px², row-major, `size` being width and height.
    pub fn of_relative_blur(size: (u32, u32), values: &[f32]) -> Self {
        Self::new(size, values, "relative_blur", "px^2")
    }

    /// Of depth in mm.
    pub fn of_depth(metric: &MetricDepth) -> Self {
        Self::new((metric.width, metric.height), &metric.depth, "depth", "mm")
    }

    /// Of a sweep: depth in mm, or focus where that is not known.
    pub fn of_sweep(sweep: &Sweep) -> Self {
        let size = (sweep.width, sweep.height);
        match &sweep.depth {
            Some(found) => Self::new(size, &found.depth, "depth", "mm"),
            None => Self::new(size, &sweep.focus, "focus", sweep.unit),
        }
    }

    fn new(size: (u32, u32), values: &[f32], quantity: &'static str, unit: &'static str) -> Self {
        let valid = || values.iter().copied().filter(|v| v.is_finite()).map(f64::from);
        let (low, high) = (valid().fold(f64::INFINITY, f64::min), valid().fold(f64::NEG_INFINITY, f64::max));
        let (low, scale) = match high - low {
            span if span > 0.0 => (low, span / 65534.0),
            // One value, or none: any scale will do.
            _ => (if low.is_finite() { low } else { 0.0 }, 1.0),
        };
        let sample = |v: f32| if v.is_finite() { 1 + ((f64::from(v) - low) / scale).round() as u16 } else { 0 };
        let samples = values.iter().map(|&v| sample(v)).collect();
        Self { size, samples, report: Depth16Report { quantity, unit, scale, offset: low - scale } }
    }

    /// What the samples mean.
    pub fn report(&self) -> Depth16Report {
        self.report
    }

    /// `depth16.png` and `depth16.tiff`.
    pub fn files(&self) -> [Extra<'_>; 2] {
        let [png, tiff] = DEPTH16_FILES;
        [Extra::new(png, |w| self.write_png(w)), Extra::new(tiff, |w| self.write_tiff(w))]
    }

    fn comments(&self) -> String {
        let quantity = match self.report.quantity {
            "depth" => "Depth",
            "focus" => "Focus",
            _ => "Relative blur V",
        };
        format!("{quantity}, {} = offset + scale * sample; sample 0 is not valid", self.report.unit)
    }

    fn write_png(&self, writer: &mut dyn Write) -> Result<(), String> {
        let meaning = Meaning { units: self.report.unit, comments: self.comments().into() };
        let mut encoder = picture::encoder(writer, self.size, &meaning)?;
        picture::add_text(&mut encoder, "Scale", &self.report.scale.to_string())?;
        picture::add_text(&mut encoder, "Offset", &self.report.offset.to_string())?;
        picture::finish(encoder, ColorType::Grayscale, &Stored::Words(&self.samples))
    }

    fn write_tiff(&self, writer: &mut dyn Write) -> Result<(), String> {
        let Depth16Report { unit, scale, offset, .. } = self.report;
        let description = format!("{}\nunits={unit}\nscale={scale}\noffset={offset}\n", self.comments());
        // The format goes back and forth in its file.
        let mut bytes = Cursor::new(Vec::new());
        let encode = |bytes: &mut Cursor<Vec<u8>>| {
            let mut encoder = TiffEncoder::new(bytes)?;
            let mut image = encoder.new_image::<Gray16>(self.size.0, self.size.1)?;
            image.encoder().write_tag(Tag::ImageDescription, description.as_str())?;
            image.encoder().write_tag(Tag::Software, SOFTWARE)?;
            image.write_data(&self.samples)
        };
        encode(&mut bytes).map_err(|e| e.to_string())?;
        writer.write_all(&bytes.into_inner()).map_err(|e| e.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(field: &Depth16) -> Vec<Option<f64>> {
        let Depth16Report { scale, offset, .. } = field.report();
        field.samples.iter().map(|&s| (s > 0).then(|| offset + scale * f64::from(s))).collect()
    }

    #[test]
    fn every_value_is_back_to_half_a_step() {
        let stored: Vec<f32> = (0..999).map(|i| 600.0 + 0.137 * ((i * i) % 977) as f32).chain([f32::NAN]).collect();
        let field = Depth16::of_relative_blur((100, 10), &stored);
        for (found, value) in values(&field).into_iter().zip(stored) {
            assert_eq!(found.is_none(), value.is_nan());
            assert!(found.is_none_or(|v| (v - f64::from(value)).abs() <= 0.5001 * field.report.scale), "{value}");
        }
        assert!(field.samples.contains(&1) && field.samples.contains(&65535));
    }

    #[test]
    fn one_value_none_and_the_widest_range_have_a_scale() {
        assert_eq!(values(&Depth16::of_relative_blur((2, 1), &[-2.5, f32::NAN])), [Some(-2.5), None]);
        assert_eq!(values(&Depth16::of_relative_blur((2, 1), &[f32::NAN, f32::INFINITY])), [None, None]);
        let wide = Depth16::of_relative_blur((2, 1), &[f32::MIN, f32::MAX]);
        assert_eq!(wide.samples, [1, 65535]);
        assert!(wide.report.scale.is_finite() && wide.report.offset.is_finite());
    }
}
