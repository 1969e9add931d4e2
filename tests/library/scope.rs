//! Tests of the solve options (region, cropping, flat reference) and of shading.

use crate::common::scene::{exposed, luminance, pair, slanted};
use crate::common::{TestEngine, blur_error};
use parfocal::{
    Frame, PairSolver, Region, Settings, Solution, SolveOptions, settings::FieldCurvature, transform::Similarity,
};

const SIZE: [u32; 2] = [300, 280];

fn transform() -> Similarity {
    Similarity::new(1.3, -0.9, 0.15, 1.01)
}

fn clean_pair() -> [Frame; 2] {
    pair(SIZE, transform(), slanted(SIZE[0]), 0.0, 5)
}

fn settings() -> Settings {
    Settings { max_relative_blur: Some(16.0), ..Settings::default() }
}

fn solve(scope: &SolveOptions, [i1, i2]: [&Frame; 2], settings: &Settings) -> Solution {
    PairSolver::new(&TestEngine::on_any(), settings).unwrap().solve([i1, i2], scope).unwrap()
}

fn v_rms(solution: &Solution) -> f64 {
    let left = f64::from(solution.origin[0]);
    let truth = |x: usize, _: usize| {
        let [v1, v2] = slanted(SIZE[0])([left + x as f64, 0.0]);
        v2 - v1
    };
    blur_error(solution, truth).0
}

fn corner(solution: &Solution) -> f64 {
    solution.transform.corner_distance(transform(), SIZE[0], SIZE[1])
}

#[test]
fn a_region_has_the_solution_of_the_whole_frame() {
    let [i1, i2] = clean_pair();
    let region = Region { x: 120, y: 90, width: 150, height: 110 };
    let scope = SolveOptions { region: Some(region), ..SolveOptions::default() };
    let solution = solve(&scope, [&i1, &i2], &settings());
    assert_eq!((solution.origin, solution.width, solution.height), ([120, 90], 150, 110));
    assert_eq!(solution.photograph, SIZE);
    let (at_corner, v) = (corner(&solution), v_rms(&solution));
    println!(
        "region: corner of the whole frame {at_corner:.4} px, V rms {v:.4} px², valid {}",
        solution.valid_fraction
    );
    assert!(at_corner < 0.05 && v < 0.05 && solution.valid_fraction == 1.0);
    let held = Settings { start: transform().into(), method: parfocal::settings::Method::Aligned, ..settings() };
    assert!(corner(&solve(&scope, [&i1, &i2], &held)) < 1e-3, "the start was not applied to the whole frame");
    let outside = SolveOptions { region: Some(Region { x: 200, ..region }), ..SolveOptions::default() };
    let mut solver = PairSolver::new(&TestEngine::on_any(), &settings()).unwrap();
    let refused = solver.solve([&i1, &i2], &outside).unwrap_err();
    assert!(refused.to_string().contains("200,90,150,110"), "{refused}");
}

#[test]
fn cropped_results_are_valid_everywhere() {
    let [i1, i2] = clean_pair();
    let solution = solve(&SolveOptions { crop_valid: true, ..SolveOptions::default() }, [&i1, &i2], &settings());
    assert!(solution.relative_blur.iter().all(|v| v.is_finite()) && solution.valid_fraction == 1.0);
    assert!(solution.width > 260 && solution.height > 240, "{:?}", solution.region());
    assert!(v_rms(&solution) < 0.05 && corner(&solution) < 0.02);
    assert_eq!(solution.fused.len(), (solution.width * solution.height) as usize);
}

/// I2 darkens towards the corners, by about a third.
#[test]
fn shading_is_estimated_and_corrected() {
    let [i1, i2] = clean_pair();
    let darker = |x: f64, y: f64| 1.0 - 0.35 * ((x - 160.0).powi(2) + (y - 130.0).powi(2)) / 4e4;
    let values = luminance(&i2).into_iter().enumerate().map(|(i, v)| {
        let (x, y) = (i as u32 % SIZE[0], i as u32 / SIZE[0]);
        (v * darker(x.into(), y.into())) as f32
    });
    let i2 = Frame::gray(SIZE[0], SIZE[1], values.collect()).unwrap();
    let found = solve(&SolveOptions::default(), [&i1, &i2], &settings());
    let [low, high] = found.shading.range();
    let (at_corner, v) = (corner(&found), v_rms(&found));
    println!("shading {low:.3} to {high:.3}; corner {at_corner:.4} px, V rms {v:.4}");
    assert!((high / low - darker(160.0, 130.0) / darker(0.0, 279.0)).abs() < 0.1);
    assert!(at_corner < 0.05 && v < 0.08);
    assert!(found.converged && found.warnings.iter().any(|w| w.contains("% brighter")), "{:?}", found.warnings);
    // Equal photographs have no shading.
    let even = solve(&SolveOptions::default(), [&i1, &exposed(&i1, 0.8, 0.0)], &settings());
    let [low, high] = even.shading.range();
    assert!(low > 0.99 && high < 1.01, "{low} to {high}");
    // The shading of a region refers to the solved part of the frame.
    let region = Region { x: 120, y: 90, width: 150, height: 110 };
    let part = solve(&SolveOptions { region: Some(region), ..SolveOptions::default() }, [&i1, &i2], &settings());
    for place in [[130.0, 100.0], [200.0, 150.0], [260.0, 190.0]] {
        let bright = |s: &Solution| s.brightness().apply(0.5, place);
        assert!((bright(&part) / bright(&found) - 1.0).abs() < 0.02, "{place:?}");
    }
}

#[test]
fn a_flat_reference_is_subtracted() {
    let [i1, i2] = clean_pair();
    let plain = solve(&SolveOptions::default(), [&i1, &i2], &settings());
    // The slanted plane is its own flat target, so only V at the centre remains.
    let flat = FieldCurvature::of_flat_target(SIZE, &plain.relative_blur, &plain.uncertainty).unwrap();
    let scope = SolveOptions { flat: Some(flat), crop_valid: true, ..SolveOptions::default() };
    let solution = solve(&scope, [&i1, &i2], &settings());
    let largest = solution.relative_blur.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    println!("largest |V| {largest:.3} px²");
    assert!(largest < 0.2, "{largest}");
    // Pixels at the limit of |V| stay at the limit, and V can be restored.
    let limited = Settings { max_relative_blur: Some(2.0), ..settings() };
    let flat = scope.flat.clone();
    let bounded = solve(&SolveOptions { flat: flat.clone(), ..SolveOptions::default() }, [&i1, &i2], &limited);
    let before = solve(&SolveOptions::default(), [&i1, &i2], &limited);
    let at_limit = |s: &Solution| s.relative_blur.iter().filter(|v| v.abs() >= 1.998).count();
    assert!(at_limit(&before) > 1000 && at_limit(&bounded) == at_limit(&before));
    let restored = flat.unwrap().restored(&solution);
    let center = (restored.height / 2 * restored.width + restored.width / 8) as usize;
    assert!((restored.relative_blur[center] - solution.relative_blur[center]).abs() > 2.0);
    let small = FieldCurvature::of_flat_target([30, 28], &vec![1.0; 840], &vec![0.1; 840]).unwrap();
    let mut solver = PairSolver::new(&TestEngine::on_any(), &settings()).unwrap();
    let refused = solver.solve([&i1, &i2], &SolveOptions { flat: Some(small), ..SolveOptions::default() });
    assert!(refused.unwrap_err().to_string().contains("30x28"));
}
