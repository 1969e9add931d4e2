//! The standard deviation of u.

use super::start::smoothed;
use super::validity::Rectangle;
use crate::base::workers;
use crate::engine::stages::Field;

/// σ of the window over which a step averages D and b, px.
const STEP_WINDOW: f64 = 2.0;
/// σ of the window over which the deviation is averaged, px.
const DEVIATION_WINDOW: f64 = 4.0;
/// σ over which neighbours share errors of b, px.
const SHARED_ERROR: f64 = 1.0;
/// D counts beyond this multiple of the D that noise makes. The D of a flat region varies by a fifth from window to
/// window, and so do both estimates of noise. The smaller one counts.
const NOISE_FACTOR: f64 = 2.0;

/// The linear system of the last iteration.
pub(super) struct FinalSystem {
    d: Field,
    /// D as noise of variance 1 makes it.
    d_of_noise: Field,
    /// D as noise as large as the residuals makes it.
    d_of_residuals: Field,
    /// b after the step.
    b: Field,
}

impl FinalSystem {
    /// From the layers of the system before the step, and u before and after it.
    pub(super) fn after_step(layers: Vec<Field>, before: &Field, after: &Field) -> Option<Self> {
        let [d, mut b, d_of_noise, d_of_residuals] = <[Field; 4]>::try_from(layers).ok()?;
        let steps = after.data.iter().zip(&before.data).map(|(after, before)| after - before);
        b.data.iter_mut().zip(&d.data).zip(steps).for_each(|((b, d), step)| *b -= d * step);
        Some(Self { d, d_of_noise, d_of_residuals, b })
    }

    /// `sqrt(4 <(G₁ b)²> 4π/(N <D>²) + 4 <(u - G₂ u)²>)`, means over σ 4 px, N = 4π [`STEP_WINDOW`]², D less what noise
    /// makes of it; NaN where nothing is left.
    ///
    /// b is added over pairs before it is squared, so that errors that pairs share count. The second term is what the
    /// window rounds off. Noise is at most as large as the residuals, which also hold what the model does not explain.
    /// It is also at most as large as the frame at the end of the sweep in which the pixel is farther out of focus:
    /// blur and the band pass leave least texture there. The smaller counts. `ends`: both frames, and the pixels that
    /// they show. u is relative to the middle setting.
    pub(super) fn deviation(&self, focus: &Field, ends: &[(Field, Rectangle); 2]) -> Field {
        let map = |f: &(dyn Fn(usize) -> f64 + Sync)| Field { data: (0..focus.data.len()).map(f).collect(), ..*focus };
        let near =
            workers::map(2, |n| if n == 0 { smoothed(&self.b, SHARED_ERROR) } else { smoothed(focus, STEP_WINDOW) });
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
        let means = workers::map(6, |n| {
            let field = match n {
                0 => map(&|i| errors.data[i].powi(2)),
                1 => self.d.clone(),
                2 => self.d_of_noise.clone(),
                3 => map(&noise),
                4 => self.d_of_residuals.clone(),
                _ => map(&|i| (focus.data[i] - rounded.data[i]).powi(2)),
            };
            smoothed(&field, DEVIATION_WINDOW)
        });
        map(&|i| {
            let [errors, d, of_noise, noise, of_residuals, bend] = [0, 1, 2, 3, 4, 5].map(|n| means[n].data[i]);
            // If one of them is NaN, `min` gives the other.
            let information = d - NOISE_FACTOR * of_residuals.min(of_noise * noise);
            if information > f64::MIN_POSITIVE {
                (4.0 * errors / (STEP_WINDOW * STEP_WINDOW * information.powi(2)) + 4.0 * bend).sqrt()
            } else {
                f64::NAN
            }
        })
    }
}
