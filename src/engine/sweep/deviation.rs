//! The standard deviation of u.

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

/// By D and b of all pairs: `sqrt(4 <(G₁ b)²> 4π/(N <D>²) + 4 <(u - G₂ u)²>)`, means over a window of σ 4 px, N = 4π WINDOW². b is summed
/// over pairs before it is squared, so that errors that pairs share count; the second term is what the window rounds off.
pub(super) fn of(focus: &Field, [d, b]: &[Field; 2]) -> Field {
    let squared = |field: &Field| Field { data: field.data.iter().map(|v| v * v).collect(), ..*field };
    let noise = mean(&squared(&mean(b, COMMON)), JUDGED);
    let information = mean(d, JUDGED);
    let mut rounded = mean(focus, WINDOW);
    rounded.data.iter_mut().zip(&focus.data).for_each(|(value, u)| *value = u - *value);
    let bend = mean(&squared(&rounded), JUDGED);
    Field::from_fn(focus.width, focus.height, |x, y| {
        let (noise, information, bend) = (noise.get(x, y), information.get(x, y), bend.get(x, y));
        (4.0 * noise / (WINDOW * WINDOW * information.powi(2).max(1e-24)) + 4.0 * bend).sqrt()
    })
}
