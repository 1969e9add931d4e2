//! The state of a solve on the device, and the displacement of a pixel by T.
//!
//! The CPU reference of `glsl/include/state.glsl`.

use bytemuck::{Pod, Zeroable};

use super::{Number, Real};
use crate::base::{Homography, Photometric, Shading};
use crate::engine::shaders;

/// The most levels of a pyramid: a short side of 32 px on the twelfth is 65536 px on the first.
pub const MAX_LEVELS: usize = shaders::state::MAX_LEVELS as usize;
const _: () = assert!(Shading::TERMS == shaders::shading::TERMS as usize);

/// α of the coarsest level before it is estimated.
pub const FIRST_ALPHA: f64 = 0.003;

/// The state buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct State {
    /// T, gain and offset.
    pub registration: Single,
    /// Correlation of the low-passed images when it was last measured: with the exposure, or else at the end.
    pub correlation: f32,
    /// 1 if the last step had unknowns that the images do not determine.
    pub degenerate: u32,
    /// α of the current level.
    pub alpha: f32,
    /// Shape of the kernel: 0 a Gaussian, 1 a disk.
    pub kernel_shape: f32,
    /// σ of noise in S, intensities, an M-estimate from adjacent pixels; 0 until T is steady on the finest level.
    pub spread: f32,
    /// Standard deviation of the scale of V, as a share of V; 0 until the finest level is solved.
    pub scale_deviation: f32,
    /// By how much the correlation of neighbouring residuals in a window counts, 0 to 1.
    pub correlated: f32,
    /// Σ b² / Σ D of the latest iteration.
    pub variance: f32,
    /// Pixels that the latest step moved by more than a tenth of their standard deviation.
    pub moving: u32,
    /// Pixels that it moved by more than half of it.
    pub moving_far: u32,
    /// Pixels with data that it left at the limit of |V|.
    pub at_limit: u32,
    /// Clipped pixels of I1 and I2 that no mask excludes.
    pub clipped: [u32; 2],
    /// Workgroups of the current dispatch that have stored their sums; 0 between dispatches.
    pub finished: u32,
    /// The [unit of intensities](super::unit) in those of the photographs, a power of two.
    pub unit: f32,
    /// The largest intensity of both photographs; 0 unless blur stacks are packed.
    pub white: f32,
    /// T when I2 was last warped onto I1's pixels.
    pub warped: Single,
    /// Coefficients of the shading.
    pub shading: [f32; Shading::TERMS],
    /// The shading that I2 was last multiplied by.
    pub applied_shading: [f32; Shading::TERMS],
    /// By level, finest first.
    pub levels: [LevelState; MAX_LEVELS],
}

impl State {
    /// Offset in bytes of the word that is 1 once a level has settled.
    pub(crate) fn settled_at(level: usize) -> usize {
        std::mem::offset_of!(Self, levels) + level * size_of::<LevelState>() + std::mem::offset_of!(LevelState, settled)
    }
}

/// T, gain and offset in single precision, as on the device.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Single {
    /// M minus the identity, by rows: zeros if T is the identity.
    pub linear: [f32; 4],
    /// t, pixels of the full-size image.
    pub t: [f32; 2],
    /// g, 1/px of the full-size image.
    pub g: [f32; 2],
    /// Gain of I2.
    pub gain: f32,
    /// Offset of I2.
    pub offset: f32,
}

/// The progress of a level.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LevelState {
    /// Outer iterations.
    pub iterations: u32,
    /// Energy per valid pixel of the latest iteration.
    pub energy: f32,
    /// Valid pixels.
    pub valid: f32,
    /// Bit n: I2 was warped again before iteration 2ⁿ.
    pub warps: u32,
    /// 1 once T and V are at rest, or the solve is cancelled: the level has no more iterations.
    pub settled: u32,
    /// The share of the valid pixels below the limit of |V| that the latest step moved.
    pub moving: f32,
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

/// The state in double precision, for the CPU references.
#[derive(Clone, Debug)]
pub struct DoubleState {
    /// T, gain and offset.
    pub registration: Registration,
    /// T when I2 was last warped onto I1's pixels.
    pub warped: Registration,
    /// The shading.
    pub shading: Shading,
    /// The shading that I2 was last multiplied by.
    pub applied_shading: Shading,
    /// Correlation of the low-passed images.
    pub correlation: f64,
    /// The last step had unknowns that the images do not determine.
    pub degenerate: bool,
    /// α of the current level.
    pub alpha: f64,
    /// Shape of the kernel: 0 a Gaussian, 1 a disk.
    pub kernel_shape: f64,
    /// σ of noise in S, intensities.
    pub spread: f64,
    /// Standard deviation of the scale of V, as a share of V.
    pub scale_deviation: f64,
    /// By how much the correlation of neighbouring residuals in a window counts, 0 to 1.
    pub correlated: f64,
    /// Σ b² / Σ D of the latest iteration.
    pub variance: f64,
    /// Pixels that the latest step moved by more than a tenth and by more than half of their standard deviation; pixels
    /// with data that it left at the limit of |V|.
    pub moving: [f64; 3],
    /// Clipped pixels of I1 and I2 that no mask excludes.
    pub clipped: [u32; 2],
    /// The [unit of intensities](super::unit) in those of the photographs, a power of two.
    pub unit: f64,
    /// The largest intensity of both photographs; 0 unless blur stacks are packed.
    pub white: f64,
    /// By level, finest first.
    pub levels: [DoubleLevel; MAX_LEVELS],
}

/// The progress of a level, in double precision.
#[derive(Clone, Copy, Debug, Default)]
pub struct DoubleLevel {
    /// Outer iterations.
    pub iterations: u32,
    /// Energy per valid pixel of the latest iteration.
    pub energy: f64,
    /// Valid pixels.
    pub valid: f64,
    /// Bit n: I2 was warped again before iteration 2ⁿ.
    pub warps: u32,
    /// T and V are at rest: the level has no more iterations.
    pub settled: bool,
    /// The share of the valid pixels below the limit of |V| that the latest step moved.
    pub moving: f64,
}

impl DoubleState {
    /// Adds counts of pixels that a step moved, that it moved far, and that it left at the limit.
    pub(crate) fn count(&mut self, moving: [u32; 3]) {
        self.moving.iter_mut().zip(moving).for_each(|(sum, count)| *sum += f64::from(count));
    }

    /// The state before a solve that estimates α.
    pub fn new(start: Registration) -> Self {
        Self {
            registration: start,
            warped: start,
            shading: Shading::NONE,
            applied_shading: Shading::NONE,
            correlation: 0.0,
            degenerate: false,
            alpha: FIRST_ALPHA,
            kernel_shape: 0.0,
            spread: 0.0,
            scale_deviation: 0.0,
            correlated: 0.0,
            variance: 0.0,
            moving: [0.0; 3],
            clipped: [0; 2],
            unit: 1.0,
            white: 0.0,
            levels: [DoubleLevel::default(); MAX_LEVELS],
        }
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
        self.registration.into()
    }

    /// The shading that I2 was last multiplied by.
    pub fn applied_shading(&self) -> Shading {
        Shading { coefficients: self.applied_shading.map(f64::from) }
    }
}

impl From<&DoubleState> for State {
    fn from(double: &DoubleState) -> Self {
        let level = |n: usize| {
            let DoubleLevel { iterations, energy, valid, warps, settled, moving } = double.levels[n];
            let [energy, valid, moving] = [energy, valid, moving].map(|number| number as f32);
            LevelState { iterations, energy, valid, warps, settled: settled.into(), moving }
        };
        let [moving, moving_far, at_limit] = double.moving.map(|count| count as u32);
        Self {
            registration: (&double.registration).into(),
            correlation: double.correlation as f32,
            degenerate: double.degenerate.into(),
            alpha: double.alpha as f32,
            kernel_shape: double.kernel_shape as f32,
            spread: double.spread as f32,
            scale_deviation: double.scale_deviation as f32,
            correlated: double.correlated as f32,
            variance: double.variance as f32,
            moving,
            moving_far,
            at_limit,
            clipped: double.clipped,
            finished: 0,
            unit: double.unit as f32,
            white: double.white as f32,
            warped: (&double.warped).into(),
            shading: double.shading.coefficients.map(|c| c as f32),
            applied_shading: double.applied_shading.coefficients.map(|c| c as f32),
            levels: std::array::from_fn(level),
        }
    }
}

impl From<&State> for DoubleState {
    fn from(single: &State) -> Self {
        let level = |n: usize| {
            let LevelState { iterations, energy, valid, warps, settled, moving } = single.levels[n];
            let [energy, valid, moving] = [energy, valid, moving].map(f64::from);
            DoubleLevel { iterations, energy, valid, warps, settled: settled == 1, moving }
        };
        Self {
            registration: single.registration(),
            warped: single.warped.into(),
            shading: Shading { coefficients: single.shading.map(f64::from) },
            applied_shading: single.applied_shading(),
            correlation: single.correlation.into(),
            degenerate: single.degenerate == 1,
            alpha: single.alpha.into(),
            kernel_shape: single.kernel_shape.into(),
            spread: single.spread.into(),
            scale_deviation: single.scale_deviation.into(),
            correlated: single.correlated.into(),
            variance: single.variance.into(),
            moving: [single.moving, single.moving_far, single.at_limit].map(f64::from),
            clipped: single.clipped,
            unit: single.unit.into(),
            white: single.white.into(),
            levels: std::array::from_fn(level),
        }
    }
}

impl From<&Registration> for Single {
    fn from(r: &Registration) -> Self {
        let [[xx, xy, tx], [yx, yy, ty], [gx, gy, _]] = r.transform.matrix();
        Self {
            linear: [xx - 1.0, xy, yx, yy - 1.0].map(|v| v as f32),
            t: [tx as f32, ty as f32],
            g: [gx as f32, gy as f32],
            gain: r.gain as f32,
            offset: r.offset as f32,
        }
    }
}

impl From<Single> for Registration {
    /// An invalid T becomes the identity; the solution warns of it.
    fn from(single: Single) -> Self {
        let ([xx, xy, yx, yy], [tx, ty]) = (single.linear.map(f64::from), single.t.map(f64::from));
        let [gx, gy] = single.g.map(f64::from);
        let matrix = [[1.0 + xx, xy, tx], [yx, 1.0 + yy, ty], [gx, gy, 1.0]];
        let transform = Homography::from_matrix(matrix).unwrap_or_default();
        Self { transform, gain: single.gain.into(), offset: single.offset.into() }
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

    /// `T x - x` on a level whose pixels are `factor` wide.
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

    /// The displacements of the pixels of a row from (x, y) on.
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

/// A place from the centre, -1 to 1 along either side.
pub fn from_centre(place: [f64; 2], centre: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|i| (place[i] - centre[i]) / centre[i])
}

/// Whether the window of three σ lies inside both images: at (x, y) in I1, and at (x, y) + d in I2, where it is `scale`
/// times as wide.
#[inline(always)]
pub fn inside([x, y]: [usize; 2], d: [f64; 2], size: [usize; 2], v: f64, scale: f64) -> bool {
    margin([x as f64, y as f64], d, size, v, scale) >= 0.0
}

/// How far the windows of [`inside`] are inside, pixels; negative if they are not.
#[inline(always)]
pub(super) fn margin<R: Real>([x, y]: [R; 2], d: [R; 2], [width, height]: [usize; 2], v: R, scale: f64) -> R {
    let reach = R::of(3.0) * v.abs().sqrt();
    let within = |p: R, size: usize, reach: R| p.min(R::of(size as f64 - 1.0) - p) - reach;
    let reach2 = R::of(scale) * reach;
    let first = within(x, width, reach).min(within(y, height, reach));
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
