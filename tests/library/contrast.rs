//! Tests of what the contrasts of both photographs show: pairs without a difference of blur.

use parfocal::{Settings, Solution, transform::Similarity};

use crate::common::TestEngine;
use crate::common::scene::{noisy_pair, slanted};

/// Solves a pair with noise of each photograph.
fn solve(
    engine: &TestEngine,
    size: [u32; 2],
    blur: impl Fn([f64; 2]) -> [f64; 2],
    noise: [f64; 2],
    seed: u64,
) -> Solution {
    let transform = Similarity::new(1.3, -0.9, 0.15, 1.01);
    engine.solve(noisy_pair(size, transform, blur, noise, seed).each_ref(), &Settings::default())
}

const WARNING: &str = "no difference of blur";

#[test]
fn photographs_of_one_focus_setting_show_no_difference_whichever_is_noisy() {
    let engine = TestEngine::new();
    for (size, seed) in [([96, 64], 1), ([160, 128], 2), ([224, 160], 3)] {
        for noise in [[0.003, 0.003], [0.0, 0.03], [0.04, 0.01]] {
            let solution = solve(&engine, size, |_| [0.3, 0.3], noise, seed);
            let said = solution.warnings.join("\n");
            assert!(said.contains(WARNING), "{size:?}, noise {noise:?}: {said}");
            // Equal noise does not make V wrong.
            assert_eq!(solution.converged, noise[0] == noise[1], "{size:?}, noise {noise:?}: {said}");
        }
    }
}

#[test]
fn a_small_difference_of_blur_is_one() {
    let engine = TestEngine::new();
    for (size, seed) in [([96, 64], 4), ([160, 128], 5)] {
        for noise in [[0.02, 0.02], [0.003, 0.01]] {
            let half = |[x, _]: [f64; 2]| [0.3, if x < 0.5 * f64::from(size[0]) { 0.3 } else { 1.3 }];
            let spot = |[x, y]: [f64; 2]| {
                let distance = (x - 40.0).hypot(y - 32.0);
                [0.3, 0.3 + 2.0 * (-distance * distance / 200.0).exp()]
            };
            for (name, solution) in [
                ("0.6 px² everywhere", solve(&engine, size, |_| [0.3, 0.9], noise, seed)),
                ("a half", solve(&engine, size, half, noise, seed)),
                ("a spot", solve(&engine, size, spot, noise, seed)),
                ("a slant", solve(&engine, size, slanted(size[0]), noise, seed)),
            ] {
                let said = solution.warnings.join("\n");
                assert!(solution.converged && said.is_empty(), "{name}, {size:?}, noise {noise:?}: {said}");
            }
        }
    }
}
