//! The standard deviation of u.

use super::start::each;
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
    convolve::twin(&convolve::twin(field, &filter, 1, false), &filter, 1, true)
}

/// What exceeds by less than this the D that noise makes may be noise too: the D of a flat region varies by a fifth, from window to window.
const OF_NOISE: f64 = 1.6;

/// What all pairs tell in the last iteration.
pub(super) struct Told {
    /// D, and how much of it noise makes.
    d: Field,
    noise: Field,
    /// b where the step has led.
    b: Field,
}

impl Told {
    /// Of the layers of the system as it was before the step, and u before and after it.
    pub(super) fn after(system: Vec<Field>, before: &Field, after: &Field) -> Option<Self> {
        let [d, mut b, noise] = <[Field; 3]>::try_from(system).ok()?;
        let steps = after.data.iter().zip(&before.data).map(|(after, before)| after - before);
        b.data.iter_mut().zip(&d.data).zip(steps).for_each(|((b, d), step)| *b -= d * step);
        Some(Self { d, noise, b })
    }

    /// `sqrt(4 <(G₁ b)²> 4π/(N <D>²) + 4 <(u - G₂ u)²>)`, means over a window of σ 4 px, N = 4π WINDOW², D less what noise makes. b is summed
    /// over pairs before it is squared, so that errors that pairs share count; the second term is what the window rounds off.
    pub(super) fn deviation(&self, focus: &Field) -> Field {
        let squared = |field: &Field| Field { data: field.data.iter().map(|v| v * v).collect(), ..*field };
        let less = |a: &Field, b: &Field, share: f64| Field {
            data: a.data.iter().zip(&b.data).map(|(a, b)| a - share * b).collect(),
            ..*a
        };
        let means = each(3, |n| match n {
            0 => mean(&squared(&mean(&self.b, COMMON)), JUDGED),
            1 => mean(&less(&self.d, &self.noise, OF_NOISE), JUDGED),
            _ => mean(&squared(&less(focus, &mean(focus, WINDOW), 1.0)), JUDGED),
        });
        Field::from_fn(focus.width, focus.height, |x, y| {
            let [noise, information, bend] = [0, 1, 2].map(|n| means[n].get(x, y));
            (4.0 * noise / (WINDOW * WINDOW * information.max(1e-12).powi(2)) + 4.0 * bend).sqrt()
        })
    }
}
