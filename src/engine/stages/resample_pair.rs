//! What a pixel sees at V and T: I1, J, and both images blurred.

use super::Field;
use super::blur::{self, Stacks};
use super::spline::{self, Jet};
use super::stack::Blurred;
use super::state::Registration;

/// Smooth Heaviside, equation 35.
pub fn heaviside(v: f64, epsilon: f64) -> f64 {
    0.5 + (v / epsilon).atan() / std::f64::consts::PI
}

/// What a pixel sees: I1, J before gain and offset, Î1 and Î2. Gradients are by I1's pixels.
pub(super) struct Seen {
    pub(super) i1: f64,
    pub(super) i2: Jet,
    pub(super) blurred: [Blurred; 2],
}

/// What a pixel sees at V, on a level with a kernel of that mean, whose pixels are `factor` wide, with that centre.
pub(super) fn see(
    (mean, factor, centre): ([f32; 2], f32, [f32; 2]),
    r: &Registration,
    warped: Option<&Registration>,
    [x, y]: [usize; 2],
    i1: &Field,
    v: f64,
    stacks: &Stacks,
) -> Seen {
    let (factor, centre) = (factor.into(), centre.map(f64::from));
    if let Some(before) = warped {
        let shift = r.moved_since(before).displacement(x, y, factor, centre);
        let i1 = spline::near(&stacks.first[0], x, y, [0.0; 2]).value;
        let (i2, blurred) = blur::read_near(stacks, [x, y], shift, v);
        return Seen { i1, i2, blurred };
    }
    let (p, d) = ([x as f64, y as f64], r.displacement(x, y, factor, centre));
    let mut i2 = spline::read(&stacks.second[0], p[0] + d[0], p[1] + d[1]);
    [i2.dx, i2.dy] = r.in_first([i2.dx, i2.dy]);
    Seen { i1: i1.get(x, y), i2, blurred: blur::read(stacks, r, mean.map(f64::from), p, d, v) }
}
