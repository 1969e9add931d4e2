//! The quantities of results: V, focus and depth with their standard deviations.

use std::borrow::Cow;

use super::Results;
use crate::base::{Decode, Error, Frame};
use crate::engine::solution::confidence;
use crate::engine::stages::scale_deviation::without_scale;
use crate::files::export::report::{Kind, UNITS};
use crate::files::export::scale::Quantity;
use crate::metric::evidence;
use crate::solve::fill::filled;
use crate::solve::resample::luminance;

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
        let (noise, fused) = (self.field("residual")?, self.fused()?);
        let channels = fused.format().channels.count() as usize;
        let intensities = fused.intensities(self.report.values.decode);
        let grey: Vec<f32> =
            intensities.chunks_exact(channels).map(|pixel| pixel.iter().sum::<f32>() / channels as f32).collect();
        Ok(Some(evidence(&grey, &noise, self.report.size.width as usize)))
    }
}
