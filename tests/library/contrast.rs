//! Tests of what the contrasts of both photographs show: pairs without a difference of blur, shaken ones, those whose
//! brightness changes them as blur does, and compressed ones.

use std::f64::consts::TAU;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use parfocal::frame::{Channels, Samples};
use parfocal::{Frame, Settings, Solution, transform::Similarity};

use crate::common::TestEngine;
use crate::common::scene::{Exposures, Radiance, luminance, pair_by, pair_of, slanted};

/// Solves a pair, displaced by about 1.6 px.
fn solve(
    engine: &TestEngine,
    size: [u32; 2],
    blur: impl Fn([f64; 2]) -> [f64; 2],
    exposures: Exposures,
    seed: u64,
) -> Solution {
    let transform = Similarity::new(1.3, -0.9, 0.15, 1.01);
    engine.solve(pair_by(exposures, size, transform, blur, seed).each_ref(), &Settings::default())
}

fn noisy(noise: [f64; 2]) -> Exposures {
    Exposures { noise, ..Exposures::default() }
}

#[test]
fn photographs_of_one_focus_setting_show_no_difference_whichever_is_noisy() {
    let engine = TestEngine::on_any();
    for (size, seed) in [([96, 64], 1), ([160, 128], 2), ([224, 160], 3)] {
        for noise in [[0.003, 0.003], [0.0, 0.03], [0.04, 0.01]] {
            let solution = solve(&engine, size, |_| [0.3, 0.3], noisy(noise), seed);
            let said = solution.warnings.join("\n");
            assert!(said.contains("no difference of blur"), "{size:?}, noise {noise:?}: {said}");
            // Equal noise does not make V wrong. Unequal noise may.
            let most = solution.relative_blur.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            let is_wrong = !solution.converged && noise[0] != noise[1];
            assert!(is_wrong || solution.converged && most < 0.3, "{size:?}, noise {noise:?}, {most} px²: {said}");
        }
    }
}

#[test]
fn a_small_difference_of_blur_is_one() {
    let engine = TestEngine::on_any();
    for (size, seed) in [([96, 64], 4), ([160, 128], 5)] {
        for noise in [[0.02, 0.02], [0.003, 0.01]] {
            let half = |[x, _]: [f64; 2]| [0.3, if x < 0.5 * f64::from(size[0]) { 0.3 } else { 1.3 }];
            let spot = |[x, y]: [f64; 2]| {
                let distance = (x - 40.0).hypot(y - 32.0);
                [0.3, 0.3 + 2.0 * (-distance * distance / 200.0).exp()]
            };
            for (name, solution) in [
                ("0.6 px² everywhere", solve(&engine, size, |_| [0.3, 0.9], noisy(noise), seed)),
                ("a half", solve(&engine, size, half, noisy(noise), seed)),
                ("a spot", solve(&engine, size, spot, noisy(noise), seed)),
                ("a slant", solve(&engine, size, slanted(size[0]), noisy(noise), seed)),
            ] {
                let said = solution.warnings.join("\n");
                assert!(solution.converged && said.is_empty(), "{name}, {size:?}, noise {noise:?}: {said}");
            }
        }
    }
}

#[test]
fn a_camera_that_moved_during_one_exposure_is_noticed_with_its_direction() {
    let engine = TestEngine::on_any();
    for (size, seed, degrees) in [([128, 96], 1, 0.0), ([160, 128], 2, 35.0), ([224, 160], 3, 90.0)] {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        for (length, noise) in [(6.0, 0.003), (9.0, 0.02)] {
            for image in [0, 1] {
                let mut exposures = noisy([noise; 2]);
                exposures.paths[image] = [length * cos, length * sin];
                let solution = solve(&engine, size, slanted(size[0]), exposures, seed);
                let said = solution.warnings.join("\n");
                let along = said.split(["or I1 along ", "I2 moved along "][image]).nth(1);
                let along = along.and_then(|text| text.split('°').next()).and_then(|text| text.parse::<f64>().ok());
                let off = along.map(|along| (along - degrees + 90.0).rem_euclid(180.0) - 90.0);
                // The directions that are compared are 15° apart.
                assert!(
                    !solution.converged && off.is_some_and(|off| off.abs() <= 15.0),
                    "{size:?}, I{} by {length} px along {degrees}°, noise {noise}: {said}",
                    image + 1
                );
            }
        }
    }
}

#[test]
fn pictures_whose_brightness_or_noise_stands_for_blur_do_not_determine_v() {
    let engine = TestEngine::on_any();
    let transform = Similarity::new(1.3, -0.9, 0.15, 1.01);
    let full = |size: [u32; 2], n: f64| n * TAU / f64::from(size[0]);
    for (size, seed, period) in [([128, 96], 1, 12.0), ([160, 128], 2, 16.0), ([224, 160], 3, 20.0)] {
        let k = TAU / period;
        for (name, waves, v, noise, is_determined) in [
            ("one frequency", vec![[k, 0.2]], 4.0, 0.003, false),
            ("nearly one frequency", vec![[k, 0.2], [1.5 * k, 0.02]], 4.0, 0.003, false),
            ("a smooth picture with noise", vec![[full(size, 0.5), 0.05], [full(size, 1.0), 0.15]], 4.0, 0.02, false),
            ("a grating with its harmonics", vec![[k, 0.1], [2.0 * k, 0.1], [3.0 * k, 0.1]], 1.0, 0.003, true),
        ] {
            let frames = pair_of(&Radiance::gratings(&waves), size, transform, |_| [0.3, 0.3 + v], noise, seed);
            let solution = engine.solve(frames.each_ref(), &Settings::default());
            let said = solution.warnings.join("\n");
            assert_eq!(solution.converged, is_determined, "{name}, {size:?}: {said}");
            let is_said = said.contains("do not determine V") || said.contains("too little texture");
            assert_eq!(is_said, !is_determined, "{name}, {size:?}: {said}");
        }
        // Without a gain to find, a grating determines V.
        let one = Radiance::gratings(&[[k, 0.2]]);
        let frames = pair_of(&one, size, transform, |_| [0.3, 4.3], 0.003, seed);
        let settings = Settings { photometric: false, ..Settings::default() };
        let solution = engine.solve(frames.each_ref(), &settings);
        assert!(solution.converged && solution.warnings.is_empty(), "{size:?}: {:?}", solution.warnings);
    }
}

#[test]
fn a_lens_that_focuses_colors_apart_is_named_and_counts_in_sigma() {
    let engine = TestEngine::on_any();
    let transform = Similarity::new(1.3, -0.9, 0.15, 1.01);
    for (size, seed) in [([160, 128], 2), ([224, 160], 3)] {
        let solve = |shifts: [f64; 3]| {
            let blur = slanted(size[0]);
            let channel = |c: usize| {
                let shifted = |x| [blur(x)[0] + 1.5 - 0.5 * shifts[c], blur(x)[1] + 1.5 + 0.5 * shifts[c]];
                pair_of(&Radiance::new(seed), size, transform, shifted, 0.003, 10 * seed + c as u64)
            };
            let planes = [0, 1, 2].map(channel);
            let frames = [0, 1].map(|n| {
                let values = planes.each_ref().map(|pair| luminance(&pair[n]));
                let pixel = |i: usize| [0, 1, 2].map(|c| values[c][i] as f32);
                let samples = (0..values[0].len()).flat_map(pixel).collect();
                Frame::new(size[0], size[1], Channels::Rgb, Samples::F32(samples)).unwrap()
            });
            engine.solve(frames.each_ref(), &Settings::default())
        };
        // V by green, and the share of pixels that are off by more than three standard deviations.
        let beyond = |solution: &Solution| {
            let pixels = solution.relative_blur.iter().zip(&solution.uncertainty).enumerate();
            let measured = pixels.filter(|(_, (v, deviation))| v.is_finite() && **deviation < 2.0);
            let off = measured.map(|(i, (v, deviation))| {
                let [first, second] = slanted(size[0])([(i % size[0] as usize) as f64, 0.0]);
                (f64::from(*v) - (second - first)).abs() > 3.0 * f64::from(*deviation)
            });
            let off: Vec<bool> = off.collect();
            assert!(off.len() > size[0] as usize * 64);
            off.iter().filter(|off| **off).count() as f64 / off.len() as f64
        };
        let shifted = solve([1.4, 0.0, -1.0]);
        let (found, said) = (shifted.color_shift.unwrap(), shifted.warnings.join("\n"));
        assert!((found.red - 1.4).abs() < 0.15 && (found.blue + 1.0).abs() < 0.15, "{size:?}: {found:?}");
        assert!(shifted.converged && said.contains("focuses colours apart"), "{size:?}: {said}");
        assert!(beyond(&shifted) < 0.02, "{size:?}: {}", beyond(&shifted));
        let alike = solve([0.0; 3]);
        let found = alike.color_shift.unwrap();
        assert!(found.included == 0.0 && found.red.abs() < 0.1 && found.blue.abs() < 0.1, "{size:?}: {found:?}");
        assert!(alike.warnings.is_empty(), "{size:?}: {:?}", alike.warnings);
    }
}

/// The frame in 8 bits by the sRGB curve, compressed as JPEG with a quality of 1 to 100, or not.
fn compressed(frame: &Frame, quality: Option<u8>) -> Frame {
    let stored = |v: &f64| {
        let curve = if *v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (255.0 * curve).round() as u8
    };
    let mut values: Vec<u8> = luminance(frame).iter().map(stored).collect();
    if let Some(quality) = quality {
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
        encoder.write_image(&values, frame.width(), frame.height(), ExtendedColorType::L8).unwrap();
        values = image::load_from_memory(&bytes).unwrap().into_luma8().into_raw();
    }
    Frame::new(frame.width(), frame.height(), Channels::Gray, Samples::U8(values)).unwrap()
}

#[test]
fn a_photograph_compressed_until_its_blocks_show_is_named() {
    let engine = TestEngine::on_any();
    for (size, seed) in [([128, 96], 1), ([168, 128], 2), ([224, 160], 3)] {
        let transform = Similarity::new(1.3, -0.9, 0.15, 1.01);
        let pair = pair_by(noisy([0.003; 2]), size, transform, slanted(size[0]), seed);
        let said = |qualities: [Option<u8>; 2]| {
            let frames = [0, 1].map(|n| compressed(&pair[n], qualities[n]));
            engine.solve(frames.each_ref(), &Settings::default()).warnings.join("\n")
        };
        for (qualities, named) in [
            ([None, Some(10)], "I2 was compressed as JPEG"),
            ([Some(10), None], "I1 was compressed as JPEG"),
            ([Some(15), Some(10)], "both photographs were compressed as JPEG"),
        ] {
            let said = said(qualities);
            assert!(said.contains(named), "{size:?}, {qualities:?}: {said}");
        }
        for qualities in [[None, None], [None, Some(90)], [Some(90), Some(90)]] {
            assert_eq!(said(qualities), "", "{size:?}, {qualities:?}");
        }
    }
}
