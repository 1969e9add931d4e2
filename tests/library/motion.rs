//! Tests of the motion models on known maps, of the comparison with simpler and richer models, and of the standard
//! deviation of T.

use parfocal::{
    Settings, Solution,
    settings::Motion,
    transform::{Homography, Similarity},
};

use crate::common::scene::{Radiance, pair, pair_of, slanted};
use crate::common::{TestEngine, blur_error};

const SIZE: [u32; 2] = [256, 192];

/// Homography K R K⁻¹ of a camera that rotates about x, y and z. The focal length is in pixels, the angles in degrees.
fn hand_held(focal: f64, [x, y, z]: [f64; 3]) -> Homography {
    let [x, y, z] = [x, y, z].map(f64::to_radians);
    let product = |a: [[f64; 3]; 3], b: [[f64; 3]; 3]| -> [[f64; 3]; 3] {
        let cell = |i: usize, j: usize| (0..3).map(|k: usize| a[i][k] * b[k][j]).sum::<f64>();
        std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j)))
    };
    let about_x = [[1.0, 0.0, 0.0], [0.0, x.cos(), -x.sin()], [0.0, x.sin(), x.cos()]];
    let about_y = [[y.cos(), 0.0, y.sin()], [0.0, 1.0, 0.0], [-y.sin(), 0.0, y.cos()]];
    let about_z = [[z.cos(), -z.sin(), 0.0], [z.sin(), z.cos(), 0.0], [0.0, 0.0, 1.0]];
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = product(about_x, product(about_y, about_z));
    let matrix = [[xx, xy, focal * xz], [yx, yy, focal * yz], [zx / focal, zy / focal, zz]];
    Homography::from_matrix(matrix).unwrap()
}

/// Homography of a flat stage that is tilted by α about y and shifted by t. A point at X moves to X cos α, at depth
/// Z + X sin α.
fn tilted_stage(focal: f64, degrees: f64, [tx, ty]: [f64; 2]) -> Homography {
    let tilt = degrees.to_radians();
    Homography::from_matrix([[tilt.cos(), 0.0, tx], [0.0, 1.0, ty], [tilt.sin() / focal, 0.0, 1.0]]).unwrap()
}

/// Solves the slanted plane, displaced by a map. Returns the corner error in px and the rms error of V in px².
fn solve(engine: &TestEngine, truth: Homography, motion: Motion) -> (Solution, [f64; 2]) {
    let [i1, i2] = pair(SIZE, truth, slanted(SIZE[0]), 0.0, 5);
    let solution = engine.solve([&i1, &i2], &Settings { motion, ..Settings::default() });
    let corner = solution.transform.corner_distance(truth, SIZE[0], SIZE[1]);
    let (v, _) = blur_error(&solution, |x, y| {
        let [v1, v2] = slanted(SIZE[0])([x as f64, y as f64]);
        v2 - v1
    });
    println!("{}: corner {corner:.4} px, V rms {v:.4} px², {:?}", motion.name(), solution.other_motion);
    (solution, [corner, v])
}

/// Checks that a homography recovers the map, and that a solve with a similarity reports the richer model.
fn check_homography(truth: Homography, [corner, v]: [f64; 2]) {
    let engine = TestEngine::on_any();
    let (solution, errors) = solve(&engine, truth, Motion::Homography);
    assert!(errors[0] <= corner && errors[1] <= v, "{errors:?}, {:?}", solution.transform);
    assert!(solution.converged, "{:?}", solution.warnings);
    assert!(solution.other_motion.is_none_or(|other| other.explains_more), "{:?}", solution.other_motion);
    let (simple, [simple_corner, _]) = solve(&engine, truth, Motion::Similarity);
    let other = simple.other_motion.expect("no richer model was compared");
    assert!(other.explains_more && other.motion == Motion::Homography, "{other:?}");
    assert!(
        (other.corner_px - simple_corner).abs() < 0.5 * simple_corner,
        "{other:?}, true corner error {simple_corner} px"
    );
}

#[test]
fn a_homography_registers_a_hand_held_pair() {
    check_homography(hand_held(300.0, [0.25, -0.35, 0.2]), [0.03, 0.1]);
}

#[test]
fn a_homography_registers_a_tilted_stage() {
    check_homography(tilted_stage(500.0, 2.0, [1.3, -0.9]), [0.03, 0.1]);
}

#[test]
fn an_affine_map_registers_a_sheared_pair() {
    let engine = TestEngine::on_any();
    let truth = Homography::from_matrix([[1.006, 0.004, 0.8], [-0.002, 0.997, -0.4], [0.0, 0.0, 1.0]]).unwrap();
    let (solution, [corner, v]) = solve(&engine, truth, Motion::Affine);
    assert!(corner <= 0.03 && v <= 0.1, "{:?}", solution.transform);
    assert!(solution.transform.is_affine() && solution.transform.similarity().is_none());
    let (simple, _) = solve(&engine, truth, Motion::Similarity);
    assert_eq!(simple.other_motion.map(|other| (other.motion, other.explains_more)), Some((Motion::Affine, true)));
}

#[test]
fn a_homography_recovers_a_similarity_and_reports_that_it_suffices() {
    let engine = TestEngine::on_any();
    let truth = Similarity::new(1.3, -0.9, 0.15, 1.01);
    let (plain, [own, _]) = solve(&engine, truth.into(), Motion::Similarity);
    assert_eq!(plain.other_motion, None);
    let (rich, [corner, _]) = solve(&engine, truth.into(), Motion::Homography);
    // 0.007 px is the error from the slope of V at the borders. The four further unknowns fit this slope more closely.
    assert!(corner <= 1.5 * own.max(0.007), "{corner} px, {own} px by a similarity");
    assert_eq!(rich.other_motion.map(|other| (other.motion, other.explains_more)), Some((Motion::Similarity, false)));
}

#[test]
fn a_translation_registers_a_shift() {
    let engine = TestEngine::on_any();
    let truth = Similarity::new(1.3, -0.9, 0.0, 1.0);
    let (solution, [corner, _]) = solve(&engine, truth.into(), Motion::Translation);
    assert!(corner <= 0.01, "{:?}", solution.transform);
    let similarity = solution.transform.similarity().unwrap();
    assert_eq!((similarity.rotation, similarity.scale), (0.0, 1.0));
    let (rich, _) = solve(&engine, truth.into(), Motion::Similarity);
    assert_eq!(rich.other_motion.map(|other| (other.motion, other.explains_more)), Some((Motion::Translation, false)));
}

/// Errors of the corners in standard deviations, over seeds of texture and noise.
#[test]
fn errors_of_t_are_as_large_as_its_standard_deviation_says() {
    let (engine, truth, size) = (TestEngine::on_any(), Similarity::new(1.3, -0.9, 0.15, 1.01), [192, 160]);
    for noise in [0.003, 0.01, 0.03] {
        let ratio = |seed| {
            let solution =
                engine.solve(pair(size, truth, slanted(size[0]), noise, seed).each_ref(), &Settings::default());
            let deviation = solution.transform_deviation.unwrap().corner_px;
            (solution.transform.corner_distance(truth, size[0], size[1]) / deviation, deviation)
        };
        let ratios: Vec<(f64, f64)> = (1..=12).map(ratio).collect();
        let within = |most: f64| ratios.iter().filter(|(ratio, _)| *ratio <= most).count();
        let rms = (ratios.iter().map(|(ratio, _)| ratio * ratio).sum::<f64>() / ratios.len() as f64).sqrt();
        let deviation = ratios.iter().map(|(_, deviation)| deviation).sum::<f64>() / ratios.len() as f64;
        println!(
            "noise {noise}: {deviation:.4} px, rms {rms:.2}, {} and {} of 12 within 1 and 2",
            within(1.0),
            within(2.0)
        );
        // The farthest of four corners: the squared ratio is 1 to 1.5 on average.
        assert!(within(2.0) >= 11 && (0.6..1.5).contains(&rms), "{ratios:?}");
    }
}

#[test]
fn stripes_do_not_determine_the_displacement_along_them() {
    let (engine, truth, size) = (TestEngine::on_any(), Similarity::new(1.3, -0.9, 0.0, 1.0), [160, 128]);
    let mut lost = 0;
    for (seed, degrees) in [(1, 0.0), (2, 35.0), (3, 90.0), (4, 140.0)] {
        let stripes = Radiance::stripes(seed, degrees);
        for noise in [0.001, 0.01] {
            let frames = pair_of(&stripes, size, truth, slanted(size[0]), noise, seed);
            let solution = engine.solve(frames.each_ref(), &Settings::default());
            let said = solution.warnings.join("\n");
            assert!(!solution.converged && solution.transform_deviation.is_none(), "{degrees}°, {noise}: {said}");
            if said.contains("do not overlap") {
                // T has left the picture along the stripes.
                lost += 1;
                continue;
            }
            let along = said.split("determine the registration along ").nth(1).and_then(|text| text.split('°').next());
            let along: f64 = along.unwrap_or_else(|| panic!("{degrees}°, {noise}: {said}")).parse().unwrap();
            let off = (along - degrees + 90.0).rem_euclid(180.0) - 90.0;
            assert!(off.abs() < 5.0, "{degrees}°, {noise}: {said}");
        }
        let [i1, i2] = pair(size, truth, slanted(size[0]), 0.01, seed);
        let solution = engine.solve([&i1, &i2], &Settings::default());
        assert!(solution.converged && solution.warnings.is_empty(), "{:?}", solution.warnings);
    }
    assert!(lost <= 2, "{lost}");
}
