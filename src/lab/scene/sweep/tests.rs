//! Frames of a sweep against images of pairs, which are tested by themselves, and the truth against closed forms.

use super::*;
use crate::lab::scene::files::floats;
use crate::lab::scene::{Kernel, Preset};

const SIZE: [u32; 2] = [70, 40];

/// Eleven frames: what the surface of a scene shares between its ends, 0 to 1, is in focus at settings 1 to 9.
fn eleven(preset: Preset) -> SweepScene {
    let scene = Scene { width: SIZE[0], height: SIZE[1], noise: 0.0, ..preset.scene() };
    SweepScene::new(scene, 11)
}

/// The second image of a pair on the same texture: under one blur all over, seen by T.
fn under(sweep: &SweepScene, variance: f64, transform: Similarity, exposure: Exposure) -> Frame {
    let shape = Shape::Uniform { variance };
    Scene { shape, transform, exposure, ..sweep.scene.clone() }.render().unwrap().i2
}

fn worst(a: &Frame, b: &Frame, counts: impl Fn(usize) -> bool) -> f32 {
    let pairs = floats(a).iter().zip(floats(b)).enumerate().filter(|(i, _)| counts(*i));
    pairs.map(|(_, (a, b))| (a - b).abs()).fold(0.0, f32::max)
}

/// The first terrace is in focus at 1, the last at 9.
#[test]
fn each_terrace_is_sharp_in_its_frame_and_blurred_by_the_law_in_others() {
    let sweep = eleven(Preset::Steps);
    let found = sweep.render().unwrap();
    for (terrace, u) in [(0, 1.0), (6, 9.0)] {
        let within = |i: usize| i % 70 / 10 == terrace;
        assert!((0..70 * 40).filter(|i| within(*i)).all(|i| (f64::from(found.focus[i]) - u).abs() < 1e-6));
        for (k, frame) in found.frames.iter().enumerate() {
            let variance = sweep.blur_rate * (k as f64 - u).powi(2);
            let expected = under(&sweep, variance, Similarity::IDENTITY, Exposure::default());
            assert!(worst(frame, &expected, within) < 1e-6, "terrace {terrace}, frame {k}");
        }
    }
}

/// Where nothing is blurred, every frame is the second image of a pair of its T and exposure.
#[test]
fn frames_lie_and_shine_as_the_truth_says() {
    let moved = SweepScene { breathing: 0.06, drift: 8.0, rotation: 0.02, gain_drift: 0.05, ..eleven(Preset::Plane) };
    let sweep = SweepScene { blur_rate: 1e-9, ..moved };
    let found = sweep.render().unwrap();
    assert_eq!((found.reference, found.shots[5].transform), (5, Similarity::IDENTITY));
    for (frame, shot) in found.frames.iter().zip(&found.shots) {
        let expected = under(&sweep, 0.0, shot.transform, shot.exposure);
        assert!(worst(frame, &expected, |_| true) < 1e-6, "frame {}", shot.position);
    }
    let (first, last) = (&found.shots[0], &found.shots[10]);
    let (a, b) = (first.transform, last.transform);
    assert!((b.scale - a.scale - 0.06).abs() < 1e-12 && (b.rotation - a.rotation - 0.02).abs() < 1e-12);
    assert!(((b.tx - a.tx).hypot(b.ty - a.ty) - 8.0).abs() < 1e-12);
    assert!((first.exposure.gain - 0.95).abs() < 1e-12 && (last.exposure.gain - 1.05).abs() < 1e-12);
    // Smooth: no step is much longer than the mean.
    let step = |s: &[Shot]| (s[1].transform.tx - s[0].transform.tx).hypot(s[1].transform.ty - s[0].transform.ty);
    assert!(found.shots.windows(2).all(|s| step(s) < 1.4 * 0.8), "{:?}", found.shots);
}

/// With the rate of the lens, the frames at the settings of the scene's ends are the images of the pair, occlusion and all.
#[test]
fn the_ends_of_a_scene_with_a_lens_are_its_pair() {
    for (preset, kernel) in [(Preset::Cylinders, Kernel::Gaussian), (Preset::Blocks, Kernel::Pillbox)] {
        let mut sweep = eleven(preset);
        sweep.scene.kernel = kernel;
        sweep.scene.transform = Similarity::IDENTITY;
        let lens = *sweep.scene.lens().unwrap();
        // Setting 1 is where I1 is focused, eight settings before I2.
        sweep.blur_rate = lens.variance(0, lens.focus[1]) / 64.0;
        let (found, pair) = (sweep.render().unwrap(), sweep.scene.render().unwrap());
        let off = worst(&found.frames[1], &pair.i1, |_| true);
        assert!(off < 1e-6, "{}: {off}", sweep.scene.name);
        for (u, z) in found.focus.iter().zip(pair.depth.unwrap()) {
            let expected = lens.variance(0, z.into()) / sweep.blur_rate;
            assert!(((f64::from(*u) - 1.0).powi(2) - expected).abs() < 1e-3, "{u} at {z} mm");
        }
    }
}

/// The pixels of the reference, darker towards the corners of the last frame and brighter towards those of the first.
#[test]
fn corners_darken_from_frame_to_frame() {
    let even = SweepScene { blur_rate: 1e-9, ..eleven(Preset::Plane) };
    let (found, plain) = (SweepScene { vignetting: 0.06, ..even.clone() }.render().unwrap(), even.render().unwrap());
    assert_eq!(found.frames[5], plain.frames[5]);
    for (k, corner) in [(0, 1.06), (10, 0.94)] {
        let factor = |i: usize| floats(&found.frames[k])[i] / floats(&plain.frames[k])[i];
        assert!((factor(0) - corner).abs() < 1e-6 && (factor(70 * 40 - 1) - corner).abs() < 1e-6, "frame {k}");
        // Half-way to the corner, a quarter.
        assert!(((factor(10 * 70 + 17) - 1.0) / (corner - 1.0) - 0.25).abs() < 0.02, "frame {k}");
    }
}

#[test]
fn the_seed_decides_and_every_frame_has_its_own_noise() {
    let mut sweep = SweepScene { drift: 3.0, ..eleven(Preset::Relief) };
    let clean = sweep.render().unwrap();
    sweep.scene.noise = 0.01;
    let found = sweep.render().unwrap();
    assert_eq!(found, sweep.render().unwrap());
    let noise = |k: usize| floats(&found.frames[k]).iter().zip(floats(&clean.frames[k])).map(|(a, b)| a - b);
    let product = |i, j| noise(i).zip(noise(j)).map(|(a, b)| f64::from(a * b)).sum::<f64>() / 2800.0;
    assert!((product(3, 3).sqrt() / 0.01 - 1.0).abs() < 0.1 && product(3, 4).abs() < 1e-5);
    sweep.scene.seed = 2;
    assert!(sweep.render().unwrap().shots[0] != found.shots[0]);
}

#[test]
fn what_cannot_be_rendered_says_which_field() {
    let plane = || eleven(Preset::Plane);
    let huge = Scene { width: 4096, height: 4096, ..Preset::Plane.scene() };
    for (sweep, part) in [
        (SweepScene { frames: 2, ..plane() }, "number of frames is 2"),
        (SweepScene { frames: 1000, ..plane() }, "number of frames"),
        (SweepScene::new(huge, 40), "pixels of all frames"),
        (SweepScene { blur_rate: 0.0, ..plane() }, "blur rate"),
        (SweepScene { blur_rate: 100.0, ..plane() }, "largest variance"),
        (SweepScene { blur_rate: 100.0, ..eleven(Preset::Bars) }, "largest variance"),
        (SweepScene { breathing: 0.3, ..plane() }, "breathing"),
        (SweepScene { drift: f64::NAN, ..plane() }, "drift"),
        (SweepScene { gain_drift: 1.0, ..plane() }, "gain drift"),
        (SweepScene { vignetting: -0.6, ..plane() }, "vignetting"),
        (eleven(Preset::HalfGaussianDots), "no depth to sweep through"),
    ] {
        let problem = sweep.render().unwrap_err().to_string();
        assert!(problem.contains(part), "{problem}");
    }
}
