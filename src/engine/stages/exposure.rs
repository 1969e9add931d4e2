//! Gain and offset from mean and deviation of the two images at low pass, each blurred as the other is by V.
//!
//! Blur takes contrast at low pass too: on random dots under a half-Gaussian of σ 2.5 the deviations alone left gain at
//! 1.016 and t_x 0.022 px off after 20 iterations a level. With half the Laplacian for each px² of V, of the level before,
//! and with both images read half way, so that interpolation takes as much from either: 1.0014 and 0.0014 px.
//!
//! Solved for from the start, gain steals blur: on strongly blurred images it drifts and V takes the wrong sign (section
//! 5 of `docs/method.md`). So this match holds until late on the finest level.

use bytemuck::{Pod, Zeroable};

use super::mask::{self, Masks};
use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::state::{Registration, inside};
use super::{Field, pixels};
use crate::engine::vulkan::{Stage, Variant};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row of the low-pass level.
    pub width: u32,
    /// Rows of the low-pass level.
    pub height: u32,
    /// Pixels of the full-size image a pixel of this level.
    pub factor: f32,
    /// The image centre in pixels of this level.
    pub centre: [f32; 2],
    /// 1: take the match; 0: only measure the correlation.
    pub adopt: u32,
    /// Pixels of the level solved a pixel of this level.
    pub stride: u32,
}

bindings! {
    EXPOSURE:
    /// I1 at low pass.
    i1: Reads<I1>,
    /// I2 at low pass.
    i2: Reads<I2>,
    /// V of the level solved.
    v: Reads<RelativeBlur>,
    /// State.
    state: Updates<State>,
    /// Masks at low pass.
    masks: Reads<Masks>,
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: the two images, and V at as many places.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        12 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, variant: Variant, memory: &mut Memory) {
        let mut r = memory.state(self.state).registration;
        let masks = mask::of(memory, self.masks, variant);
        let [i1, i2] = [memory.layer(self.i1, 0), memory.layer(self.i2, 0)];
        let correlation = twin(c, &mut r, i1, i2, memory.layer(self.v, 0), masks);
        let state = memory.state_mut(self.state);
        (state.registration, state.correlation) = (r, correlation);
    }
}

/// Matches gain and offset in place, `v` the relative blur of the level solved, `masks` where pixels are masked; gives the
/// correlation of the two images.
pub fn twin(c: &Constants, r: &mut Registration, i1: &Field, i2: &Field, v: &Field, masks: Option<&Masks>) -> f64 {
    let mut moments = [0.0; 6];
    let (size, stride) = ([i1.width, i1.height], c.stride as usize);
    for (x, y) in (0..i1.height).flat_map(|y| (0..i1.width).map(move |x| (x, y))) {
        let displaced = r.displacement(x, y, c.factor.into(), c.centre.map(f64::from));
        let [back, ahead] = meet(r, displaced);
        if !inside([x, y], back, size, 0.0, 1.0) || !inside([x, y], ahead, size, 0.0, 1.0) {
            continue;
        }
        let variance = v.clamped((x * stride) as isize, (y * stride) as isize) / (stride * stride) as f64;
        let variance = variance.clamp(-0.5, 0.5);
        let read = |image: &Field, d: [f64; 2], variance: f64| {
            bilinear(image, x as f64 + d[0], y as f64 + d[1], variance.max(0.0)) - 0.5
        };
        let (u, v) = (read(i1, back, variance), read(i2, ahead, -variance));
        for (moment, term) in moments.iter_mut().zip([1.0, u, v, u * u, v * v, u * v]) {
            *moment += mask::counts(masks, [x, y], displaced) * term;
        }
    }
    let count = f64::max(moments[0], 1.0);
    let [mean1, mean2] = [moments[1] / count, moments[2] / count];
    let variance = |square: f64, mean: f64| (square / count - mean * mean).max(0.0);
    let (variance1, variance2) = (variance(moments[3], mean1), variance(moments[4], mean2));
    let covariance = moments[5] / count - mean1 * mean2;
    let contrast = variance1.min(variance2) > 1e-6;
    let correlation = if contrast { covariance / (variance1 * variance2).sqrt() } else { 0.0 };
    if c.adopt == 1 {
        r.gain = if correlation > 0.5 { (variance1 / variance2).sqrt() } else { 1.0 };
        r.offset = mean1 + 0.5 - r.gain * (mean2 + 0.5);
    }
    correlation
}

/// The place in I1 and its place in I2 that a pixel lies half way between, from that pixel: `(1 + A)⁻¹ D`, T's displacement D
/// there and its Jacobian A. Near a turn by 180° there is no such place, and I1 is read at the pixel.
fn meet(r: &Registration, d: [f64; 2]) -> [[f64; 2]; 2] {
    let [[xx, xy], [yx, yy]] = r.transform.jacobian();
    let (xx, yy) = (1.0 + xx, 1.0 + yy);
    let determinant = xx * yy - xy * yx;
    if determinant <= 0.25 {
        return [[0.0, 0.0], d];
    }
    let ahead = [(yy * d[0] - xy * d[1]) / determinant, (xx * d[1] - yx * d[0]) / determinant];
    [ahead.map(|d| -d), ahead]
}

/// Between pixels blurred by a small variance: half of it times the Laplacian.
fn bilinear(image: &Field, x: f64, y: f64, variance: f64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (x - i, y - j);
    let at = |di: isize, dj: isize| {
        let (x, y) = (i as isize + di, j as isize + dj);
        let centre = image.clamped(x, y);
        let sides: f64 = [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().map(|(a, b)| image.clamped(x + a, y + b)).sum();
        centre + 0.5 * variance * (sides - 4.0 * centre)
    };
    (1.0 - v) * ((1.0 - u) * at(0, 0) + u * at(1, 0)) + v * ((1.0 - u) * at(0, 1) + u * at(1, 1))
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, smooth_field};
    use super::super::state::State;
    use super::*;
    use crate::base::{Photometric, Similarity};
    use crate::engine::vulkan::Resource;

    fn check(i1: &Field, i2: &Field, transform: Similarity, adopt: u32, blur: f64) -> Registration {
        check_masked(i1, i2, transform, adopt, blur, Some(&[7, 8].map(|seed| mask::shares(i1.width, i1.height, seed))));
        check_masked(i1, i2, transform, adopt, blur, None)
    }

    fn check_masked(
        i1: &Field,
        i2: &Field,
        transform: Similarity,
        adopt: u32,
        blur: f64,
        masks: Option<&Masks>,
    ) -> Registration {
        let mut expected = Registration::new(transform, &Photometric::IDENTITY);
        let state = State::new(&expected);
        let c = Constants {
            width: i1.width as u32,
            height: i1.height as u32,
            factor: 16.0,
            centre: [i1.width as f32 / 2.0 - 0.4, i1.height as f32 / 2.0 - 0.6],
            adopt,
            stride: 2,
        };
        let mut v = smooth_field(2 * i1.width - 1, 2 * i1.height - 1, 4);
        v.data.iter_mut().for_each(|v| *v = blur * (*v - 0.5));
        let correlation = twin(&c, &mut expected, i1, i2, &v, masks);
        let rig = Rig::new();
        let (images, state) =
            ([i1, i2, &v].map(|i| rig.image(std::slice::from_ref(i))), rig.upload(bytemuck::bytes_of(&state)));
        let none = [i1.clone(), i2.clone()];
        let (masked, masks) = (masks.is_some(), rig.image(masks.unwrap_or(&none)));
        let [i1, i2, v] = images.each_ref().map(Resource::Image);
        let resources = [i1, i2, v, Resource::Buffer(&state), Resource::Image(&masks)];
        rig.run_variant(&STAGE, [false, false, masked, false], &resources, &c, [1, 1, 1]);
        let found: State = rig.value(&state);
        for (found, expected) in [
            (found.registration.gain, expected.gain),
            (found.registration.offset, expected.offset),
            (found.correlation, correlation),
        ] {
            // 1e-4: differences of squares in single precision.
            assert!((f64::from(found) - expected).abs() < 1e-4, "{found} {expected}");
        }
        expected
    }

    #[test]
    fn agrees_with_the_twin_and_finds_a_known_exposure() {
        for (width, height) in [(41, 23), (16, 9), (60, 60)] {
            let i1 = smooth_field(width, height, 1);
            let mut i2 = i1.clone();
            i2.data.iter_mut().for_each(|v| *v = (*v - 0.05) / 0.8);
            let found = check(&i1, &i2, Similarity::IDENTITY, 1, 0.0);
            assert!((found.gain - 0.8).abs() < 1e-9 && (found.offset - 0.05).abs() < 1e-9, "{found:?}");
            check(&i1, &i2, Similarity::new(20.0, -9.0, 2.0, 1.04), 1, 8.0);
            check(&i1, &smooth_field(width, height, 9), Similarity::IDENTITY, 0, 2.0);
            check(&i1, &i2, Similarity::new(3.0, 5.0, 40.0, 1.1), 1, 1.0);
            check(&i1, &i2, Similarity::new(3.0, 5.0, 180.0, 1.0), 1, 1.0);
        }
    }

    #[test]
    fn places_that_meet_half_way_are_each_others() {
        for transform in [Similarity::new(3.0, -7.0, 25.0, 1.2), Similarity::new(0.0, 0.0, 90.0, 0.8)] {
            let r = Registration::new(transform, &Photometric::IDENTITY);
            let (x, centre) = ([40usize, 25usize], [31.0, 20.5]);
            let [back, ahead] = meet(&r, r.displacement(x[0], x[1], 1.0, centre));
            let moved = r.transform.apply([x[0] as f64 + back[0], x[1] as f64 + back[1]], centre);
            assert!(
                (moved[0] - x[0] as f64 - ahead[0]).abs() < 1e-9 && (moved[1] - x[1] as f64 - ahead[1]).abs() < 1e-9
            );
        }
    }

    #[test]
    fn flat_images_match_in_the_mean() {
        let flat = |v| Field::from_fn(20, 10, |_, _| v);
        let found = check(&flat(0.5), &flat(0.4), Similarity::IDENTITY, 1, 1.0);
        assert!((found.gain - 1.0).abs() < 1e-9 && (found.offset - 0.1).abs() < 1e-9, "{found:?}");
        check(&flat(0.5), &flat(0.4), Similarity::new(1e4, 0.0, 0.0, 1.0), 1, 0.0);
    }
}
