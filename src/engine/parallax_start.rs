//! The start of the parallax of a pair, on the host, on coarse levels.
//!
//! Blur hardly shows on coarse levels, where parallax is found best. So V is estimated by contrast on a finer level, which
//! hardly depends on the registration. With that V, parallax is two more unknowns of the registration by appearance.

use std::ops::Range;

use super::plan::{Plan, halving_filter};
use super::stages::separable::filtered;
use super::stages::sums::UNKNOWNS;
use super::stages::{Field, Raster, ingest, unit};
use super::sweep::contrast::relative_blur;
use super::sweep::pyramid::{CONTRAST_LEVELS, first_level};
use super::sweep::start::{self, Frames, Motion, Registered, Registration};
use crate::base::color::LUMINANCE;
use crate::base::{Error, Frame, Homography, Mask, Parallax, ParallaxSearch, Settings, Shading, workers};

/// The share of the contrast that does not correlate, from which on the registration is not trusted: up to 0.28 of eleven real
/// pairs.
const UNLIKE: f64 = 0.5;
/// The least power of the gradient in any direction, as a share of the largest. Stripes do not determine parallax along them:
/// they have up to 0.002, and eleven real pairs 0.48 and more.
const STRIPES: f64 = 0.02;
/// The most of the difference between the photographs that parallax leaves if it is asked for: it explains something.
const EXPLAINS: f64 = 0.99;
/// The same if it is not, and beyond what a map of the plane explains. Of 60 real pairs of cameras that stood still it leaves
/// 0.967 and more, of six taken by hand that moved 0.87 to 0.95.
const MOVED: f64 = 0.955;
const NO_PLANE: f64 = 0.985;
/// The least share of the parallax that three quarters of the photograph have by themselves, with a T of their own: 0.8 and
/// more of generated scenes, 0.45 and more of leaves taken by hand, up to 0.19 where a part moved by itself.
const AGREES: f64 = 0.3;

/// The most pixels of the level where it is first sought. Pictures of few levels, or of few rows, have more, and would take
/// seconds.
const MOST_PIXELS: u64 = 1 << 16;

/// The settings by which a pair is solved: [`ParallaxSearch::On`] if it shows parallax.
///
/// # Errors
/// As [`Plan::new`].
pub(crate) fn resolved(frames: [&Frame; 2], settings: &Settings, mask: Option<&Mask>) -> Result<Settings, Error> {
    let plan = Plan::new(frames[0].width(), frames[0].height(), frames.map(Frame::format), settings)?;
    let is_sought = settings.parallax == ParallaxSearch::Auto && plan.solves_transform();
    let parallax =
        if is_sought && find(frames, &plan, mask).is_some() { ParallaxSearch::On } else { settings.parallax };
    Ok(Settings { parallax, ..settings.clone() })
}

/// T and the parallax that a pair starts from; `None` if there is none.
pub(super) fn find(frames: [&Frame; 2], plan: &Plan, mask: Option<&Mask>) -> Option<(Homography, Parallax)> {
    let (settings, first) = (&plan.settings, first_level(plan));
    let [width, height] = plan.pyramid[first].size;
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        return None;
    }
    let finest = first.saturating_sub(CONTRAST_LEVELS);
    let levels = levels(frames, plan, finest..first + 1);
    let last = levels.len() - 1;
    let judged = last.saturating_sub(1);
    let appearance: Vec<Frames> = levels[judged..].iter().map(start::appearance).collect();
    let register = |l: usize, from: Motion, unknowns: usize, focus: Option<&Field>| -> Registered {
        start::register(&appearance[l - judged], 0, &Registration { start: &[from; 2], unknowns, focus })[1]
    };
    let unknowns = settings.motion.unknowns();
    let none = Motion { transform: settings.start, parallax: [0.0; 2] };
    let coarse = register(last, none, unknowns, None).motion;
    let aligned = start::resample(&levels[0], &[none, coarse], None, &[(1.0, Shading::NONE); 2]);
    let factor = levels[0].level.factor;
    let blur = relative_blur(&aligned, 1 << judged);
    let size = [blur.width, blur.height];
    // V of every `every`-th pixel, times a factor; NaN where a pixel does not count.
    let v = |every: usize, by: f64, counts: &(dyn Fn([usize; 2]) -> bool + Sync)| {
        let is_seen = |at: [usize; 2]| {
            let [x, y] = at.map(|n| (n << (judged + finest)) as f64);
            mask.is_none_or(|mask| mask.contains(x, y)) && counts(at)
        };
        Field::from_fn(size[0].div_ceil(every), size[1].div_ceil(every), |x, y| {
            let at @ [x, y] = [every * x, every * y];
            if is_seen(at) { by * factor * factor * blur.get(x, y) } else { f64::NAN }
        })
    };
    let [flat, all] = [0.0, 1.0].map(|by| v(1, by, &|_| true));
    let from = register(last, coarse, unknowns, Some(&v(1 << (last - judged), 1.0, &|_| true))).motion;
    let with = register(judged, from, unknowns, Some(&all));
    let without = register(judged, coarse, unknowns, Some(&flat));
    let leaves = |with: Registered, without: Registered, most: f64| with.left < most * without.left;
    let [x, y] = with.motion.parallax;
    let is_parallax = || {
        let plane = register(judged, without.motion, UNKNOWNS, Some(&flat));
        let both = register(judged, Motion { parallax: [x, y], ..plane.motion }, UNKNOWNS, Some(&all));
        let agrees = |&n: &usize| {
            let quarter = |[x, y]: [usize; 2]| n == usize::from(2 * x > size[0]) + 2 * usize::from(2 * y > size[1]);
            let [own_x, own_y] = register(judged, with.motion, unknowns, Some(&v(1, 1.0, &quarter))).motion.parallax;
            own_x * x + own_y * y > AGREES * (x * x + y * y)
        };
        leaves(with, without, MOVED) && leaves(both, plane, NO_PLANE) && (0..4).filter(agrees).count() >= 3
    };
    let is_found = with.unlike < UNLIKE
        && with.isotropy > STRIPES
        && leaves(with, without, EXPLAINS)
        && (settings.parallax == ParallaxSearch::On || is_parallax());
    is_found.then_some((with.motion.transform, Parallax { across: [x, y], along: 0.0 }))
}

/// The luminance of both photographs in units on some levels, the finest first.
fn levels(frames: [&Frame; 2], plan: &Plan, levels: Range<usize>) -> Vec<Frames> {
    let (filter, decode) = (halving_filter().iter().map(|w| *w as f32).collect::<Vec<_>>(), plan.settings.decode);
    let over = 1.0 / unit::cpu_reference(frames, decode, LUMINANCE);
    let mut images: Vec<Raster<f32>> = workers::map(2, |n| ingest::cpu_reference(frames[n], decode, LUMINANCE));
    let mut all = Vec::new();
    for l in 0..levels.end {
        if l > 0 {
            images = workers::map(2, |n| filtered(&images[n], [&filter; 2], 2));
        }
        if levels.contains(&l) {
            let in_units =
                |image: &Raster<f32>| Field::from_fn(image.width, image.height, |x, y| over * image.get(x, y));
            all.push(Frames { images: images.iter().map(in_units).collect(), level: plan.pyramid[l].clone() });
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Decode, Similarity};
    use crate::lab::scene::{Preset, Scene};

    /// On a slanted plane V grows along the displacement of a half of it, so that one parallax explains some of that.
    #[test]
    fn a_half_that_moved_by_itself_is_no_parallax() {
        let [still, moved] = [0.0, 5.0].map(|by| {
            let plane = Preset::Plane.scene();
            let transform = Similarity { tx: plane.transform.tx + by, ..plane.transform };
            Scene { width: 192, height: 160, noise: 0.003, transform, ..plane }.render().unwrap()
        });
        let [whole, half] = [&still, &moved].map(|scene| scene.i2.intensities(Decode::None));
        let pixels = whole.iter().zip(&half).enumerate().map(|(i, (a, b))| if i % 192 < 96 { *a } else { *b });
        let i2 = Frame::gray(192, 160, pixels.collect()).unwrap();
        let found = |i2: &Frame| resolved([&still.i1, i2], &Settings::default(), None).unwrap().parallax;
        assert_eq!([&still.i2, &i2].map(found), [ParallaxSearch::Auto; 2]);
    }
}
