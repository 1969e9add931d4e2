//! Every symmetric scene, solved with the default settings, comes back registered:
//! `cargo test --release --test scenes -- --nocapture`.

mod common;

use common::{TestEngine, blur_error};
use parfocal::scene::{Preset, Scene, Shape};
use parfocal::{Settings, Solution};

/// Solves a scene; prints its errors and fails where T is off by more than 0.01 px at a corner, 0.0003°, or 0.003 %, or V
/// by more than `rms` px².
fn solve(engine: &TestEngine, scene: &Scene, rms: f64) -> Solution {
    let pair = scene.render().unwrap();
    let solution = engine.solve([&pair.i1, &pair.i2], &Settings::default());
    let (found, truth, width) = (&solution.transform, &pair.transform, solution.width);
    let corner = found.corner_distance(truth, width, solution.height);
    let degrees = (found.rotation_deg() - truth.rotation_deg()).abs();
    let percent = 100.0 * (found.scale - truth.scale).abs();
    let (v, bias) = blur_error(&solution, |x, y| f64::from(pair.relative_blur[y * width as usize + x]));
    println!(
        "{}: corner {corner:.5} px, θ {degrees:.6}°, s {percent:.6} %, V rms {v:.4} px², bias {bias:+.4}",
        scene.name
    );
    assert!(corner <= 0.01 && degrees <= 0.0003 && percent <= 0.003, "{found:?}, not {truth:?}");
    assert!(v <= rms, "{v}");
    solution
}

#[test]
fn every_symmetric_preset_is_registered() {
    let engine = TestEngine::new();
    // At jumps and steep sides V is smoothed, which is most of its error there.
    for (preset, rms) in
        [(Preset::Plane, 0.02), (Preset::Cylinders, 0.3), (Preset::Steps, 0.25), (Preset::Relief, 0.12)]
    {
        let solution = solve(&engine, &preset.scene(), rms);
        assert!(solution.converged, "{:?}", solution.warnings);
    }
}

/// Where V is the same all over, the model of the solver is exact, and what is left is the error of both programs together.
#[test]
fn uniform_blur_is_registered_to_a_thousandth_of_a_pixel() {
    let engine = TestEngine::new();
    for variance in [1.0, 4.0] {
        let name = format!("uniform {variance} px²");
        let scene = Scene { name, shape: Shape::Uniform { variance }, ..Preset::Plane.scene() };
        let solution = solve(&engine, &scene, 0.03);
        assert!(solution.transform.corner_distance(&scene.transform, 256, 256) <= 0.001);
    }
}
