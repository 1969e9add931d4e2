//! The state of a solve on the device, and the displacement of a pixel by T.
//!
//! The CPU reference of `glsl/include/state.glsl`.

use bytemuck::Zeroable;

use super::{Number, Real};
use crate::base::{Homography, Parallax, Photometric, Shading};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use shaders::state::{LevelState, Registration as Single, State};

// The state in double precision.
include!(concat!(env!("OUT_DIR"), "/state.rs"));

/// The most levels of a pyramid: a short side of 32 px on the twelfth is 65536 px on the first.
pub const MAX_LEVELS: usize = shaders::state::MAX_LEVELS as usize;
const _: () = assert!(Shading::TERMS == shaders::shading::TERMS as usize);

/// α of the coarsest level before it is estimated.
pub const FIRST_ALPHA: f64 = 0.003;

impl State {
    /// Offset in bytes of the word that is 1 once a level has settled.
    pub(crate) fn settled_at(level: usize) -> usize {
        std::mem::offset_of!(Self, levels) + level * size_of::<LevelState>() + std::mem::offset_of!(LevelState, settled)
    }
}

/// T, gain and offset, in double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// T.
    pub transform: Homography,
    /// Gain of I2.
    pub gain: f64,
    /// Offset of I2.
    pub offset: f64,
}

/// What the device stores in single precision and the CPU references compute with in double precision. `build.rs` writes
/// it for the state, from `glsl/include/state.glsl`.
pub trait Double {
    /// The type in double precision.
    type Of;
    /// From single precision.
    fn double(&self) -> Self::Of;
    /// To single precision.
    fn single(double: &Self::Of) -> Self;
}

impl Double for f32 {
    type Of = f64;
    fn double(&self) -> f64 {
        (*self).into()
    }
    fn single(double: &f64) -> Self {
        *double as f32
    }
}

impl Double for u32 {
    type Of = u32;
    fn double(&self) -> u32 {
        *self
    }
    fn single(double: &u32) -> Self {
        *double
    }
}

impl Double for shaders::state::Parallax {
    type Of = Parallax;
    fn double(&self) -> Parallax {
        Parallax { across: [self.across_x, self.across_y].map(f64::from), along: self.along.into() }
    }
    fn single(&Parallax { across, along }: &Parallax) -> Self {
        let [across_x, across_y, along] = [across[0], across[1], along].map(|number| number as f32);
        Self { across_x, across_y, along }
    }
}

impl Double for [u32; 2] {
    type Of = [u32; 2];
    fn double(&self) -> [u32; 2] {
        *self
    }
    fn single(double: &[u32; 2]) -> Self {
        *double
    }
}

impl Double for [f32; Shading::TERMS] {
    type Of = Shading;
    fn double(&self) -> Shading {
        Shading { coefficients: self.map(f64::from) }
    }
    fn single(double: &Shading) -> Self {
        double.coefficients.map(|c| c as f32)
    }
}

impl Double for [LevelState; MAX_LEVELS] {
    type Of = [DoubleLevel; MAX_LEVELS];
    fn double(&self) -> [DoubleLevel; MAX_LEVELS] {
        self.each_ref().map(Double::double)
    }
    fn single(double: &[DoubleLevel; MAX_LEVELS]) -> Self {
        double.each_ref().map(Double::single)
    }
}

impl DoubleState {
    /// The separation of the focus settings on a level whose pixels are `factor` wide, px² of the level.
    pub(super) fn separation_on(&self, factor: f32) -> f64 {
        self.separation / f64::from(factor * factor)
    }

    /// What displaces the pixels of a level.
    pub(super) fn displacement(&self, factor: f32, centre: [f32; 2]) -> Displacement<'_> {
        let (r, parallax, centre) = (&self.registration, self.parallax, centre.map(f64::from));
        Displacement { r, parallax, factor: factor.into(), centre }
    }

    /// T when I2 was warped onto I1's pixels, for a variant of passes that read it so; `None` with parallax, when I2 is
    /// not warped.
    pub(super) fn warped_by(&self, variant: Variant) -> Option<&Registration> {
        (variant.has(Variant::WARPED) && self.parallax == Parallax::NONE).then_some(&self.warped)
    }

    /// Adds counts of pixels that a step moved, that it moved far, and that it left at the limit.
    pub(crate) fn count(&mut self, [moving, moving_far, at_limit]: [u32; 3]) {
        self.moving += moving;
        self.moving_far += moving_far;
        self.at_limit += at_limit;
    }

    /// The state before a solve that estimates α.
    pub fn new(start: Registration) -> Self {
        let (registration, warped, zero) = (start, start, State::zeroed().double());
        Self { registration, warped, alpha: FIRST_ALPHA, unit: 1.0, ..zero }
    }
}

impl Default for DoubleState {
    fn default() -> Self {
        Self::new(Registration::new(Homography::IDENTITY, &Photometric::IDENTITY))
    }
}

impl State {
    /// The state before a solve that estimates α.
    pub fn new(start: &Registration) -> Self {
        Self { registration: start.into(), alpha: FIRST_ALPHA as f32, unit: 1.0, ..Self::zeroed() }
    }

    /// T, gain and offset; the offset in units.
    pub fn registration(&self) -> Registration {
        self.registration.double()
    }

    /// The shading that I2 was last multiplied by.
    pub fn applied_shading(&self) -> Shading {
        self.applied_shading.double()
    }
}

impl From<&Registration> for Single {
    fn from(registration: &Registration) -> Self {
        Self::single(registration)
    }
}

impl Double for Single {
    type Of = Registration;

    /// An invalid T becomes the identity; the solution warns of it.
    fn double(&self) -> Registration {
        let Self { xx, xy, yx, yy, tx, ty, gx, gy, gain, offset } = *self;
        let [xx, xy, yx, yy, tx, ty, gx, gy] = [xx, xy, yx, yy, tx, ty, gx, gy].map(f64::from);
        let matrix = [[1.0 + xx, xy, tx], [yx, 1.0 + yy, ty], [gx, gy, 1.0]];
        let transform = Homography::from_matrix(matrix).unwrap_or_default();
        Registration { transform, gain: gain.into(), offset: offset.into() }
    }

    fn single(r: &Registration) -> Self {
        let [[xx, xy, tx], [yx, yy, ty], [gx, gy, _]] = r.transform.matrix();
        let numbers = [xx - 1.0, xy, yx, yy - 1.0, tx, ty, gx, gy, r.gain, r.offset];
        let [xx, xy, yx, yy, tx, ty, gx, gy, gain, offset] = numbers.map(|number| number as f32);
        Self { xx, xy, yx, yy, tx, ty, gx, gy, gain, offset }
    }
}

impl Registration {
    /// From T and gain and offset.
    pub fn new(transform: impl Into<Homography>, photometric: &Photometric) -> Self {
        Self { transform: transform.into(), gain: photometric.gain, offset: photometric.offset }
    }

    /// Gain and offset.
    pub fn photometric(&self) -> Photometric {
        Photometric { gain: self.gain, offset: self.offset }
    }

    /// The same with its offset, stated in this unit, in the intensities of the photographs.
    pub fn in_intensities(&self, unit: f64) -> Self {
        Self { offset: unit * self.offset, ..*self }
    }

    /// T after a small step.
    pub fn after(&self, step: &Homography) -> Self {
        Self { transform: self.transform.after(step), ..*self }
    }

    /// The motion of T since an earlier T₀: the map whose displacement d has `T x = T₀ (x + d)`, in I1's pixels.
    pub fn moved_since(&self, before: &Self) -> Self {
        Self { transform: before.transform.inverse().after(&self.transform), gain: 0.0, offset: 0.0 }
    }

    /// s, the square root of T's area scale at the centre.
    pub fn scale(&self) -> f64 {
        self.transform.scale()
    }

    /// A gradient per pixel of I2 as one per pixel of I1, by T's Jacobian at the centre.
    pub fn in_first(&self, [dx, dy]: [f64; 2]) -> [f64; 2] {
        let [[xx, xy], [yx, yy]] = self.transform.jacobian();
        [xx * dx + yx * dy, xy * dx + yy * dy]
    }

    /// A displacement in I1's pixels as one in I2's, by T's Jacobian at the centre.
    pub(super) fn in_second(&self, [dx, dy]: [f64; 2]) -> [f64; 2] {
        let [[xx, xy], [yx, yy]] = self.transform.jacobian();
        [xx * dx + xy * dy, yx * dx + yy * dy]
    }

    /// `T x - x`, without parallax, on a level whose pixels are `factor` wide.
    #[inline(always)]
    pub fn displacement(&self, x: usize, y: usize, factor: f64, centre: [f64; 2]) -> [f64; 2] {
        self.displacement_at([x as f64, y as f64], factor, centre)
    }

    /// The same between pixels.
    #[inline(always)]
    pub fn displacement_at(&self, x: [f64; 2], factor: f64, centre: [f64; 2]) -> [f64; 2] {
        let p = [factor * (x[0] - centre[0]), factor * (x[1] - centre[1])];
        let (d, over) = (self.transform.displacement(p), 1.0 / factor);
        [over * d[0], over * d[1]]
    }

    /// The displacements of the pixels of a row from (x, y) on by T.
    #[inline(always)]
    pub(super) fn displacements<N: Number>(
        &self,
        [x, y]: [usize; 2],
        factor: f64,
        centre: [f64; 2],
        [dx, dy]: [&mut [N]; 2],
    ) {
        for (n, (dx, dy)) in dx.iter_mut().zip(dy).enumerate() {
            let d = self.displacement(x + n, y, factor, centre);
            (*dx, *dy) = (N::of(d[0]), N::of(d[1]));
        }
    }
}

/// What displaces the pixels of a level: T, and the parallax before it.
#[derive(Clone, Copy)]
pub(super) struct Displacement<'a> {
    pub(super) r: &'a Registration,
    pub(super) parallax: Parallax,
    /// Pixels of the full-size image per pixel of the level.
    pub(super) factor: f64,
    pub(super) centre: [f64; 2],
}

impl Displacement<'_> {
    /// The derivative of the parallax by V.
    #[inline(always)]
    pub(super) fn by_v(&self, x: [f64; 2]) -> [f64; 2] {
        let Self { parallax: Parallax { across, along }, factor, centre, .. } = *self;
        [0, 1].map(|c| factor * (across[c] + along * factor * (x[c] - centre[c])))
    }

    /// T (x + parallax) - x of a pixel with this V.
    #[inline(always)]
    pub(super) fn of(&self, x: [f64; 2], v: f64) -> [f64; 2] {
        let parallax = self.by_v(x).map(|by_v| v * by_v);
        let d = self.r.displacement_at([x[0] + parallax[0], x[1] + parallax[1]], self.factor, self.centre);
        [parallax[0] + d[0], parallax[1] + d[1]]
    }

    /// Those of the pixels of a row from (x, y) on, with these V.
    #[inline(always)]
    pub(super) fn of_row<N: Number>(&self, at @ [x, y]: [usize; 2], v: &[N], [dx, dy]: [&mut [N]; 2]) {
        if self.parallax == Parallax::NONE {
            return self.r.displacements(at, self.factor, self.centre, [dx, dy]);
        }
        for (n, (dx, dy)) in dx.iter_mut().zip(dy).enumerate() {
            let d = self.of([(x + n) as f64, y as f64], v[n].into());
            (*dx, *dy) = (N::of(d[0]), N::of(d[1]));
        }
    }
}

/// A place from the centre, -1 to 1 along either side.
pub fn from_centre(place: [f64; 2], centre: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|i| (place[i] - centre[i]) / centre[i])
}

/// Whether windows of three σ lie inside both images: at (x, y) in I1, and at (x, y) + d in I2, where pixels are
/// `scale` times as wide. `variances`: of the blurs of I1 and I2.
#[inline(always)]
pub fn inside([x, y]: [usize; 2], d: [f64; 2], size: [usize; 2], variances: [f64; 2], scale: f64) -> bool {
    margin([x as f64, y as f64], d, size, variances, scale) >= 0.0
}

/// How far the windows of [`inside`] are inside, pixels; negative if they are not.
#[inline(always)]
pub(super) fn margin<R: Real>(
    [x, y]: [R; 2],
    d: [R; 2],
    [width, height]: [usize; 2],
    variances: [R; 2],
    scale: f64,
) -> R {
    let [reach1, reach2] = [R::of(3.0) * variances[0].sqrt(), R::of(3.0 * scale) * variances[1].sqrt()];
    let within = |p: R, size: usize, reach: R| p.min(R::of(size as f64 - 1.0) - p) - reach;
    let first = within(x, width, reach1).min(within(y, height, reach1));
    first.min(within(x + d[0], width, reach2)).min(within(y + d[1], height, reach2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_t_has_done_since_is_seen_in_the_pixels_of_i1() {
        let map = |shear: f64, g: f64| {
            Homography::from_matrix([[1.08, 0.02, 3.0], [0.03 + shear, 1.05, -2.0 + g], [1e-4, g, 1.0]]).unwrap()
        };
        let [before, now] = [map(0.0, 0.0), map(0.01, 2e-4)].map(|t| Registration::new(t, &Photometric::IDENTITY));
        let moved = now.moved_since(&before);
        let centre = [30.0, 20.0];
        for (x, y) in [(0usize, 0usize), (60, 10), (17, 40)] {
            let d = moved.displacement(x, y, 1.0, centre);
            let actual = before.transform.apply([x as f64 + d[0], y as f64 + d[1]], centre);
            let expected = now.transform.apply([x as f64, y as f64], centre);
            assert!((actual[0] - expected[0]).abs() < 1e-12 && (actual[1] - expected[1]).abs() < 1e-12);
        }
    }
}
