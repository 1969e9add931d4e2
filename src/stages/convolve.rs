//! One-dimensional filter along one axis, mirrored borders; with a stride it also halves.
//!
//! Three passes of the method are this one: the Gaussian pyramid (σ 1 px, stride 2; pixel i of a level sits on pixel 2i
//! of its parent), the cubic B-spline prefilter, and the stack of uniformly blurred images.

use super::field::{Field, mirror};

/// `out(i) = Σ_n filter(n) input(stride i + n)` along x, or along y.
pub fn twin(input: &Field, filter: &[f64], stride: usize, vertical: bool) -> Field {
    let radius = (filter.len() / 2) as isize;
    let tap = |x: usize, y: usize, n: isize| {
        if vertical {
            input.get(x, mirror((y * stride) as isize + n, input.height))
        } else {
            input.get(mirror((x * stride) as isize + n, input.width), y)
        }
    };
    let (width, height) = if vertical {
        (input.width, input.height.div_ceil(stride))
    } else {
        (input.width.div_ceil(stride), input.height)
    };
    Field::from_fn(width, height, |x, y| filter.iter().zip(-radius..).map(|(w, n)| w * tap(x, y, n)).sum())
}
