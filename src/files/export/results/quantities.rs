//! The quantities of results: V, focus and depth with their standard deviations.

use std::borrow::Cow;

use super::Results;
use crate::base::color::LUMINANCE;
use crate::base::statistics::median;
use crate::base::{Decode, Error, Frame};
use crate::engine::solution::confidence;
use crate::engine::stages::scale_deviation::without_scale;
use crate::engine::stages::separable::smoothed;
use crate::engine::stages::spline::Raster;
use crate::engine::stages::unit;
use crate::files::export::report::{Kind, UNITS};
use crate::files::export::scale::Quantity;
use crate::metric::evidence;
use crate::metric::response::{Detail, Smoothing};
use crate::solve::fill::filled;
use crate::solve::resample::luminance;

/// The least variance of blur under which the fused image is looked at, px², the octaves above it, and the least squared
/// sensitivity.
const LEAST_BLUR: f32 = 0.5;
const BLUR_OCTAVES: usize = 8;
const LEAST_SQUARE: f32 = 1e-12;

/// The Laplacian of an image, mirrored about its border pixels.
fn laplacian(image: &Raster<f32>, i: usize) -> f32 {
    let (x, y, width) = (i % image.width, i / image.width, image.width);
    let along = |at: usize, last: usize, step: usize| match at {
        _ if last == 0 => 0.0,
        0 => 2.0 * image.data[i + step],
        at if at == last => 2.0 * image.data[i - step],
        _ => image.data[i - step] + image.data[i + step],
    };
    along(x, width - 1, 1) + along(y, image.height - 1, width) - 4.0 * image.data[i]
}

impl Results<'_> {
    /// V of a pair, or the focus of a sweep.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Standard deviation of [`values`](Self::values).
    pub fn uncertainty(&self) -> &[f32] {
        &self.uncertainty
    }

    /// V of a pair, or the focus of a sweep, with its standard deviation.
    pub fn quantity(&self) -> Quantity<'_> {
        let (report, nearer) = (&self.report, self.report.nearer());
        match report.focus_unit {
            None => Quantity::relative_blur(self.values(), self.uncertainty(), nearer),
            Some(_) => Quantity::focus(self.values(), self.uncertainty(), self.focus_unit(), &self.positions(), nearer),
        }
    }

    /// Depth in mm if it is known, else V or the focus.
    pub fn best(&self) -> Quantity<'_> {
        self.depth().unwrap_or_else(|| self.quantity())
    }

    /// V or the focus, and then depth in mm if it is known, with NaN where they are not measured.
    pub fn measured(&self) -> Vec<Quantity<'_>> {
        let all = std::iter::once(self.quantity()).chain(self.depth());
        all.map(|quantity| quantity.without(&self.marked)).collect()
    }

    /// [`best`](Self::best) with NaN where it is not measured.
    pub fn best_measured(&self) -> Quantity<'_> {
        self.best().without(&self.marked)
    }

    /// [`best`](Self::best) with what is not measured filled in, for pictures: by σ, up to edges of the fused image. NaN
    /// where no frame of a sweep is in focus, and at all pixels if none is measured.
    pub(crate) fn filled(&self) -> &[f32] {
        self.filled.get_or_init(|| {
            let best = self.best_measured();
            let (width, channels) = (self.report.size.width as usize, |fused: &Frame| fused.format().channels);
            let guide = |fused: Frame| luminance(fused.intensities(Decode::None), channels(&fused));
            let guide = self.fused().map_or_else(|_| vec![0.0; best.values.len()], guide);
            let mut filled = filled(&best.values, &best.deviation, guide, width);
            filled.iter_mut().zip(&*self.beyond).filter(|(_, side)| **side != 0).for_each(|(v, _)| *v = f32::NAN);
            filled
        })
    }

    /// [`measured`](Self::measured) with the standard deviations between results of one lens and setup: without that of
    /// V's scale, which they share.
    pub fn comparable(&self) -> Vec<Quantity<'_>> {
        let mut quantities = self.measured();
        if let Some(shares) = self.shares_without_scale() {
            for quantity in &mut quantities {
                quantity.deviation.to_mut().iter_mut().zip(&shares).for_each(|(deviation, share)| *deviation *= share);
            }
        }
        quantities
    }

    /// Standard deviation of [`values`](Self::values) without that of V's scale.
    pub fn uncertainty_without_scale(&self) -> Cow<'_, [f32]> {
        match self.shares_without_scale() {
            Some(shares) => self.uncertainty().iter().zip(shares).map(|(deviation, share)| deviation * share).collect(),
            None => self.uncertainty().into(),
        }
    }

    /// The confidence in V without the standard deviation of V's scale: the weight of a pixel for a fit.
    pub fn confidence_without_scale(&self) -> Vec<f32> {
        self.uncertainty_without_scale().iter().map(|&deviation| confidence(deviation)).collect()
    }

    /// The share of a pixel's standard deviation that remains without that of V's scale. `None` for sweeps.
    fn shares_without_scale(&self) -> Option<Vec<f32>> {
        let scale = self.report.scale_deviation? as f32;
        let share = |(v, deviation): (&f32, &f32)| match *deviation > 0.0 {
            true => without_scale(*deviation, scale * v) / deviation,
            false => 1.0,
        };
        Some(self.values().iter().zip(self.uncertainty()).map(share).collect())
    }

    /// The part of a quantity's standard deviation that comes from the scale of V, with the sign of V. `None` for
    /// sweeps.
    pub fn by_scale(&self, quantity: &Quantity<'_>) -> Option<Vec<f32>> {
        let scale = self.report.scale_deviation? as f32;
        let pixels = self.values().iter().zip(self.uncertainty()).zip(&*quantity.deviation);
        Some(pixels.map(|((v, of_v), deviation)| scale * v * deviation / of_v).collect())
    }

    /// Unit of the focus of a sweep.
    pub(crate) fn focus_unit(&self) -> &'static str {
        let unit = self.report.focus_unit.as_deref();
        UNITS.into_iter().find(|known| unit == Some(known)).unwrap_or(UNITS[0])
    }

    /// For a pair, the evidence for each pixel of V: the standard deviation of the fused image around it over that of
    /// what neither blur nor registration explains. `None` for a sweep, since its results do not state the latter.
    ///
    /// # Errors
    /// As for [`field`](Self::field) and [`fused`](Self::fused).
    pub fn evidence(&self) -> Result<Option<Vec<f32>>, Error> {
        if self.report.kind != Kind::Pair {
            return Ok(None);
        }
        Ok(Some(evidence(&self.grey(&self.fused()?), &self.field("residual")?, self.report.size.width as usize)))
    }

    /// The mean of the channels of the fused image, in intensities.
    fn grey(&self, fused: &Frame) -> Vec<f32> {
        let channels = fused.format().channels.count() as usize;
        let intensities = fused.intensities(self.report.values.decode);
        intensities.chunks_exact(channels).map(|pixel| pixel.iter().sum::<f32>() / channels as f32).collect()
    }

    /// For a pair, the detail of V that it resolves. `None` for a sweep, and without the report of its levels.
    ///
    /// The photographs change with V by half of the Laplacian of the softer one, which is the fused image under |V|. Its
    /// square is averaged over the window of the solve, and then, as a logarithm, over σ 4 px: a few strong places do not
    /// carry a weak one.
    ///
    /// # Errors
    /// As for [`field`](Self::field) and [`fused`](Self::fused).
    pub fn detail(&self) -> Result<Option<Detail>, Error> {
        let (report, settings) = (&self.report, &self.report.settings);
        let iterations = report.levels.as_ref().and_then(|levels| levels.last()).map(|level| level.iterations);
        let (Some(regularization), Some(iterations)) = (report.regularization.filter(|a| a.is_finite()), iterations)
        else {
            return Ok(None);
        };
        let (residual, fused) = (self.field("residual")?, self.fused()?);
        let unit = unit::cpu_reference([&fused; 2], report.values.decode, LUMINANCE);
        let noise = median(residual.iter().map(|v| f64::from(*v))).unwrap_or(0.0) / unit;
        let (width, height) = (report.size.width as usize, report.size.height as usize);
        let data = self.grey(&fused).iter().map(|v| v / unit as f32).collect();
        let picture = Raster { data, ..Raster::<f32>::zeros(width, height) };
        let octave = |v: f32| if v.is_nan() { 0.0 } else { (v.abs() / LEAST_BLUR).max(1.0).log2() };
        let octaves: Vec<f32> = self.values().iter().map(|v| octave(*v).min(BLUR_OCTAVES as f32)).collect();
        let last = octaves.iter().fold(0.0, |a: f32, b| a.max(*b)).ceil() as usize;
        let mut squares = vec![0.0; width * height];
        for n in 0..=last {
            let blur = LEAST_BLUR * 2f32.powi(n as i32);
            let soft = smoothed(&picture, f64::from(blur).sqrt());
            let square = |i: usize| (0.5 * laplacian(&soft, i)).powi(2);
            let mean = smoothed(&Raster { data: (0..width * height).map(square).collect(), ..soft.clone() }, 2.0);
            // White noise under a Gaussian of variance v has half of a Laplacian of 0.2 v^-1.5.
            let of_noise = 0.04 * noise as f32 * noise as f32 / blur.powi(3);
            for ((sum, mean), octave) in squares.iter_mut().zip(&mean.data).zip(&octaves) {
                *sum += (1.0 - (octave - n as f32).abs()).max(0.0) * (mean - of_noise).max(LEAST_SQUARE);
            }
        }
        let logarithms = squares.iter().map(|square: &f32| square.max(LEAST_SQUARE).ln()).collect();
        let even = smoothed(&Raster { data: logarithms, ..picture }, 4.0);
        let (data_eta, smoothness_eta) = (settings.data_eta, settings.smoothness_eta);
        let smoothing = Smoothing { regularization, data_eta, smoothness_eta, noise, iterations, px2_per_height: 1.0 };
        Ok(Some(Detail { sensitivity: even.data.iter().map(|v| (0.5 * v).exp()).collect(), smoothing }))
    }
}
