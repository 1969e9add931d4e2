//! What the device knows of a solve, and where T puts a pixel: the twin of `glsl/include/state.glsl`.

use bytemuck::{Pod, Zeroable};

use crate::base::{Photometric, Similarity};

/// Most levels of a pyramid; a short side of 32 px on the twelfth would be 65536 px on the first.
pub const MAX_LEVELS: usize = 12;

/// The state buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct State {
    /// `s cos θ - 1`.
    pub a: f32,
    /// `s sin θ`.
    pub b: f32,
    /// Translation to the right, pixels of the full-size image.
    pub tx: f32,
    /// Translation downwards, pixels of the full-size image.
    pub ty: f32,
    /// Gain of I2.
    pub gain: f32,
    /// Offset of I2.
    pub offset: f32,
    /// Correlation of the two images at low pass, when it was last measured: in the end, at the final T.
    pub correlation: f32,
    /// 1 if the last step had unknowns that the images do not determine.
    pub degenerate: u32,
    /// T, gain and offset when I2 was last brought onto I1's pixels, in the order above.
    pub warped: [f32; 6],
    /// By level, finest first.
    pub levels: [LevelState; MAX_LEVELS],
}

/// What one level has done.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LevelState {
    /// Outer iterations.
    pub iterations: u32,
    /// 1 if the latest iteration, at the final α, moved no corner by 0.01 px and the energy by less than 0.1 %.
    pub converged: u32,
    /// Energy a valid pixel, of the latest iteration.
    pub energy: f32,
    /// Valid pixels.
    pub valid: f32,
    /// Bit n: I2 was brought onto I1's pixels anew before iteration 2ⁿ.
    pub warps: u32,
    /// 1 once the level does nothing any more.
    pub settled: u32,
}

/// T, gain and offset, in double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// `s cos θ - 1`.
    pub a: f64,
    /// `s sin θ`.
    pub b: f64,
    /// Translation, pixels of the full-size image.
    pub t: [f64; 2],
    /// Gain of I2.
    pub gain: f64,
    /// Offset of I2.
    pub offset: f64,
}

/// The state as the twins keep it, in double precision.
#[derive(Clone, Debug)]
pub struct DoubleState {
    /// T, gain and offset.
    pub registration: Registration,
    /// The same when I2 was last brought onto I1's pixels.
    pub warped: Registration,
    /// Correlation of the two images at low pass.
    pub correlation: f64,
    /// By level, finest first.
    pub levels: [DoubleLevel; MAX_LEVELS],
}

/// What one level has done, in double precision.
#[derive(Clone, Copy, Debug, Default)]
pub struct DoubleLevel {
    /// Outer iterations.
    pub iterations: u32,
    /// Energy a valid pixel, of the latest iteration.
    pub energy: f64,
}

impl DoubleState {
    /// The state before a solve.
    pub fn new(start: Registration) -> Self {
        Self { registration: start, warped: start, correlation: 0.0, levels: [DoubleLevel::default(); MAX_LEVELS] }
    }
}

impl Default for DoubleState {
    fn default() -> Self {
        Self::new(Registration::new(&Similarity::IDENTITY, &Photometric::IDENTITY))
    }
}

impl State {
    /// The state before a solve.
    pub fn new(start: &Registration) -> Self {
        Self {
            a: start.a as f32,
            b: start.b as f32,
            tx: start.t[0] as f32,
            ty: start.t[1] as f32,
            gain: start.gain as f32,
            offset: start.offset as f32,
            ..Self::zeroed()
        }
    }

    /// T, gain and offset.
    pub fn registration(&self) -> Registration {
        Registration {
            a: self.a.into(),
            b: self.b.into(),
            t: [self.tx.into(), self.ty.into()],
            gain: self.gain.into(),
            offset: self.offset.into(),
        }
    }
}

impl Registration {
    /// From T and the exposure.
    pub fn new(transform: &Similarity, photometric: &Photometric) -> Self {
        let [a, b, tx, ty] = transform.displacement();
        Self { a, b, t: [tx, ty], gain: photometric.gain, offset: photometric.offset }
    }

    /// T.
    pub fn transform(&self) -> Similarity {
        Similarity::from_displacement([self.a, self.b, self.t[0], self.t[1]])
    }

    /// Gain and offset.
    pub fn photometric(&self) -> Photometric {
        Photometric { gain: self.gain, offset: self.offset }
    }

    /// What T has done since an earlier T₀: the registration whose displacement d has `T x = T₀ (x + d)`, in I1's pixels.
    pub fn moved_since(&self, before: &Self) -> Self {
        let (re, im) = (1.0 + before.a, before.b);
        let turned_back = |[x, y]: [f64; 2]| {
            let size = re * re + im * im;
            [(x * re + y * im) / size, (y * re - x * im) / size]
        };
        let [a, b] = turned_back([self.a - before.a, self.b - before.b]);
        let t = turned_back([self.t[0] - before.t[0], self.t[1] - before.t[1]]);
        Self { a, b, t, gain: 0.0, offset: 0.0 }
    }

    /// s.
    pub fn scale(&self) -> f64 {
        (1.0 + self.a).hypot(self.b)
    }

    /// `T x - x` on a level whose pixels are `factor` wide and whose centre is `centre`.
    pub fn displacement(&self, x: usize, y: usize, factor: f64, centre: [f64; 2]) -> [f64; 2] {
        let (px, py) = (x as f64 - centre[0], y as f64 - centre[1]);
        [self.t[0] / factor + self.a * px - self.b * py, self.t[1] / factor + self.b * px + self.a * py]
    }
}

/// Whether the window of three σ lies inside both images: at (x, y) in I1, and at (x, y) + d in I2, where it is `scale`
/// times as wide.
pub fn inside([x, y]: [usize; 2], d: [f64; 2], [width, height]: [usize; 2], v: f64, scale: f64) -> bool {
    let reach = 3.0 * v.abs().sqrt();
    let within = |p: f64, size: usize, reach: f64| p >= reach && size as f64 - 1.0 - p >= reach;
    within(x as f64, width, reach)
        && within(y as f64, height, reach)
        && within(x as f64 + d[0], width, reach * scale)
        && within(y as f64 + d[1], height, reach * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_t_has_done_since_is_seen_in_the_pixels_of_i1() {
        let (before, now) = (Similarity::new(3.0, -2.0, 3.0, 1.08), Similarity::new(3.1, -2.2, 3.1, 1.07));
        let [before, now] = [before, now].map(|t| Registration::new(&t, &Photometric::IDENTITY));
        let moved = now.moved_since(&before);
        let centre = [30.0, 20.0];
        for (x, y) in [(0usize, 0usize), (60, 10), (17, 40)] {
            let d = moved.displacement(x, y, 1.0, centre);
            let at = |p: [f64; 2], r: &Registration| {
                let (px, py) = (p[0] - centre[0], p[1] - centre[1]);
                [p[0] + r.t[0] + r.a * px - r.b * py, p[1] + r.t[1] + r.b * px + r.a * py]
            };
            let (found, expected) = (at([x as f64 + d[0], y as f64 + d[1]], &before), at([x as f64, y as f64], &now));
            assert!((found[0] - expected[0]).abs() < 1e-12 && (found[1] - expected[1]).abs() < 1e-12);
        }
    }
}
