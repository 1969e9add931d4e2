//! The standard deviation of u.

use super::shown::Rectangle;
use crate::base::workers;
use crate::engine::filter;
use crate::engine::stages::{Field, convolve};

/// σ of the window over which D and b are added up for a step, px.
const WINDOW: f64 = 2.0;
/// σ of the window over which the deviation is judged, px.
const JUDGED: f64 = 4.0;
/// What b of neighbours err by in common, px.
const COMMON: f64 = 1.0;

fn mean(field: &Field, sigma: f64) -> Field {
    let filter = filter::gaussian(sigma * sigma);
    convolve::cpu_reference(&convolve::cpu_reference(field, &filter, 1, false), &filter, 1, true)
}

/// What exceeds by less than this the D that noise makes may be noise too: the D of a flat region varies by a fifth, from window to window, and
/// so do both accounts of noise, of which the smaller counts.
const OF_NOISE: f64 = 2.0;

/// What all pairs tell in the last iteration.
pub(super) struct Told {
    /// D; what noise of variance 1 makes of it, and noise as large as the residuals.
    d: Field,
    of_noise: Field,
    of_residuals: Field,
    /// b where the step has led.
    b: Field,
}

impl Told {
    /// Of the layers of the system as it was before the step, and u before and after it.
    pub(super) fn after(system: Vec<Field>, before: &Field, after: &Field) -> Option<Self> {
        let [d, mut b, of_noise, of_residuals] = <[Field; 4]>::try_from(system).ok()?;
        let steps = after.data.iter().zip(&before.data).map(|(after, before)| after - before);
        b.data.iter_mut().zip(&d.data).zip(steps).for_each(|((b, d), step)| *b -= d * step);
        Some(Self { d, of_noise, of_residuals, b })
    }

    /// `sqrt(4 <(G₁ b)²> 4π/(N <D>²) + 4 <(u - G₂ u)²>)`, means over a window of σ 4 px, N = 4π WINDOW², D less what noise makes; NaN where
    /// nothing is left of it. b is summed over pairs before it is squared, so that errors that pairs share count; the second term is what
    /// the window rounds off.
    ///
    /// Noise is at most as large as the residuals, which hold what the model does not explain too; and as the frame that the pixel is
    /// farthest out of focus in, one of those at the two `ends`, where blur and the band of the frames leave least of texture: the
    /// smaller counts. Of each end the pixels that it shows. u is less the middle of the settings.
    pub(super) fn deviation(&self, focus: &Field, ends: &[(Field, Rectangle); 2]) -> Field {
        let map = |f: &(dyn Fn(usize) -> f64 + Sync)| Field { data: (0..focus.data.len()).map(f).collect(), ..*focus };
        let near = workers::collect(2, |n| if n == 0 { mean(&self.b, COMMON) } else { mean(focus, WINDOW) });
        let [errors, rounded] = [0, 1].map(|n| &near[n]);
        let shows = |n: &usize, i: usize| {
            let ([left, top, right, bottom], x, y) = (ends[*n].1, (i % focus.width) as f64, (i / focus.width) as f64);
            x >= left && x <= right && y >= top && y <= bottom
        };
        let noise = |i: usize| {
            let farther = usize::from(focus.data[i] < 0.0);
            let end = [farther, 1 - farther].into_iter().find(|n| shows(n, i));
            end.map_or(f64::INFINITY, |n| ends[n].0.data[i].powi(2))
        };
        let means = workers::collect(6, |n| {
            let field = match n {
                0 => map(&|i| errors.data[i].powi(2)),
                1 => self.d.clone(),
                2 => self.of_noise.clone(),
                3 => map(&noise),
                4 => self.of_residuals.clone(),
                _ => map(&|i| (focus.data[i] - rounded.data[i]).powi(2)),
            };
            mean(&field, JUDGED)
        });
        map(&|i| {
            let [errors, d, of_noise, noise, of_residuals, bend] = [0, 1, 2, 3, 4, 5].map(|n| means[n].data[i]);
            // The smaller, of whatever is a number.
            let information = d - OF_NOISE * of_residuals.min(of_noise * noise);
            if information > f64::MIN_POSITIVE {
                (4.0 * errors / (WINDOW * WINDOW * information.powi(2)) + 4.0 * bend).sqrt()
            } else {
                f64::NAN
            }
        })
    }
}
