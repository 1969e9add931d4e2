//! The whole formation of an image.

use super::*;
use crate::base::centre;

fn values(frame: &Frame) -> &[f32] {
    match frame.samples() {
        Samples::F32(values) => values,
        other => panic!("{other:?}"),
    }
}

fn sharp(radiance: Radiance, transform: Similarity) -> Scene {
    let shape = Shape::Plane { limit: 0.0 };
    Scene { width: 65, height: 65, base_blur: 0.0, shape, radiance, transform, ..Preset::Plane.scene() }
}

/// With V = 0, `I2(T x) = I1(x)` for each T that takes pixels to pixels: by a right angle, by 3-4-5 triangles, by shifts.
#[test]
fn where_blur_is_equal_the_images_agree_under_every_similarity() {
    let triangle = (0.6f64).acos().to_degrees();
    let shapes = [(0.0, 0.0, 0.0, 1.0), (3.0, -2.0, 0.0, 1.0), (1.0, 2.0, 90.0, 1.0), (-4.0, 1.0, 270.0, 2.0)];
    let more = [(2.0, -1.0, triangle, 5.0), (0.0, 3.0, -triangle, 5.0), (1.0, 0.0, 180.0, 0.5)];
    for (tx, ty, degrees, scale) in shapes.into_iter().chain(more) {
        let t = Similarity::new(tx, ty, degrees, scale);
        for radiance in [Radiance::Texture, Radiance::Dots] {
            let pair = sharp(radiance, t).render().unwrap();
            let (i1, i2) = (values(&pair.i1), values(&pair.i2));
            let mut compared = 0;
            for (i, value) in i1.iter().enumerate() {
                let [x, y] = t.apply([(i % 65) as f64, (i / 65) as f64], centre(65, 65));
                let whole = (x - x.round()).abs() < 1e-9 && (y - y.round()).abs() < 1e-9;
                let (x, y) = (x.round(), y.round());
                if whole && (0.0..65.0).contains(&x) && (0.0..65.0).contains(&y) {
                    compared += 1;
                    let other = i2[y as usize * 65 + x as usize];
                    assert!((value - other).abs() < 1e-6, "{t:?} at ({x}, {y}): {value} and {other}");
                }
            }
            assert!(compared > 100, "{t:?}: {compared}");
        }
    }
}

/// A symmetric kernel commutes with the similarity: blur of equal variance on I1's grid leaves the images alike. An
/// asymmetric one does not, being oriented with its own sensor.
#[test]
fn equal_blur_on_the_grid_of_i1_stays_equal_under_scale_and_rotation() {
    let t = Similarity::new(0.0, 0.0, 90.0, 2.0);
    for (kernel, equal) in [(Kernel::Gaussian, true), (Kernel::Pillbox, true), (Kernel::HalfGaussian, false)] {
        let pair = Scene { base_blur: 2.0, kernel, ..sharp(Radiance::Texture, t) }.render().unwrap();
        let at = |frame: &Frame, x: usize, y: usize| values(frame)[y * 65 + x];
        let worst = (0..16)
            .flat_map(|i| (0..16).map(move |j| (i, j)))
            .map(|(i, j)| {
                let (x, y) = (24 + i, 24 + j);
                let [u, v] = t.apply([x as f64, y as f64], centre(65, 65));
                (at(&pair.i1, x, y) - at(&pair.i2, u.round() as usize, v.round() as usize)).abs()
            })
            .fold(0.0, f32::max);
        assert_eq!(worst < 1e-6, equal, "{kernel:?}: {worst}");
    }
}

#[test]
fn the_seed_decides_and_noise_has_its_deviation() {
    let scene = Scene { width: 48, height: 32, noise: 0.01, ..Preset::Relief.scene() };
    let pair = scene.render().unwrap();
    assert_eq!(pair, scene.render().unwrap());
    let other = Scene { seed: 2, ..scene.clone() }.render().unwrap();
    assert!(other.i1 != pair.i1 && other.relative_blur != pair.relative_blur);
    let clean = Scene { noise: 0.0, ..scene }.render().unwrap();
    for (a, b) in [(&pair.i1, &clean.i1), (&pair.i2, &clean.i2)] {
        let squares = values(a).iter().zip(values(b)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        let deviation = (squares / (48.0 * 32.0)).sqrt();
        assert!((deviation / 0.01 - 1.0).abs() < 0.1, "{deviation}");
    }
}

#[test]
fn exposure_is_undone_by_its_photometric() {
    let plain = Scene { width: 32, height: 32, ..Preset::Plane.scene() };
    let exposed = Scene { exposure: Exposure { gain: 0.9, offset: 0.05 }, ..plain.clone() }.render().unwrap();
    let (plain, p) = (plain.render().unwrap(), exposed.photometric);
    assert!((p.gain - 1.0 / 0.9).abs() < 1e-12 && (p.offset + 0.05 / 0.9).abs() < 1e-12);
    assert_eq!(exposed.i1, plain.i1);
    for (a, b) in values(&exposed.i2).iter().zip(values(&plain.i2)) {
        assert!((p.gain * f64::from(*a) + p.offset - f64::from(*b)).abs() < 1e-6);
    }
}

#[test]
fn no_preset_clips_and_contrast_scales_about_the_middle() {
    for preset in Preset::ALL {
        let scene = Scene { width: 64, height: 64, ..preset.scene() };
        let pair = scene.render().unwrap();
        for frame in [&pair.i1, &pair.i2] {
            assert!(values(frame).iter().all(|v| (0.02..=0.98).contains(v)), "{}", scene.name);
        }
        assert_eq!(pair.depth.is_some(), preset.scene().lens().is_some());
        let half = Scene { contrast: 0.45, ..scene }.render().unwrap();
        assert!((values(&half.i1)[77] - 0.5 - 0.5 * (values(&pair.i1)[77] - 0.5)).abs() < 1e-6);
    }
}

#[test]
fn the_lens_decides_blur_and_depth() {
    let scene = Scene { width: 64, height: 64, ..Preset::Cylinders.scene() };
    let (pair, lens) = (scene.render().unwrap(), *scene.lens().unwrap());
    assert!((scene.transform.scale - lens.breathing()).abs() < 1e-12);
    for (v, z) in pair.relative_blur.iter().zip(pair.depth.as_ref().unwrap()) {
        assert!((lens.relative_blur(f64::from(*z), lens.breathing()) - f64::from(*v)).abs() < 1e-3);
    }
}

#[test]
fn a_scene_is_plain_data() {
    for preset in Preset::ALL {
        let text = serde_json::to_string(&preset.scene()).unwrap();
        assert_eq!(serde_json::from_str::<Scene>(&text).unwrap(), preset.scene(), "{text}");
    }
}

#[test]
fn what_cannot_be_rendered_says_which_field() {
    let plane = || Preset::Plane.scene();
    let cases = [
        (Scene { width: 8, ..plane() }, "8x256 is too small"),
        (Scene { width: 1 << 20, height: 1 << 20, ..plane() }, "number of pixels"),
        (Scene { noise: -0.1, ..plane() }, "noise is -0.1"),
        (Scene { noise: f64::NAN, ..plane() }, "noise"),
        (Scene { contrast: 0.0, ..plane() }, "contrast"),
        (Scene { shape: Shape::Plane { limit: 1e9 }, ..plane() }, "largest relative blur"),
        (Scene { transform: Similarity::new(0.0, 0.0, 0.0, 0.0), ..plane() }, "scale"),
        (Scene { exposure: Exposure { gain: 0.0, offset: 0.0 }, ..plane() }, "gain of I2"),
    ];
    for (scene, part) in cases {
        let problem = scene.render().unwrap_err().to_string();
        assert!(problem.contains(part), "{problem}");
    }
    let lens = Lens { f_number: 0.01, ..*Preset::Cylinders.scene().lens().unwrap() };
    let blurred = Scene { shape: Shape::Cylinders { lens }, ..plane() };
    assert!(blurred.render().unwrap_err().to_string().contains("largest variance"));
}
