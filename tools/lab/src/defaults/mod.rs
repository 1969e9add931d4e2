//! Bounds on the accuracy of the default settings.
//!
//! All solves use the settings of a user who states none, except for an asymmetric kernel, which is stated.

mod photographs;
mod scenes;

use std::path::Path;

use parfocal::{
    Solution,
    internals::median,
    internals::scene::{Kernel, Preset, Scene},
};

use self::scenes::{RATIO, USUAL};
use crate::errors::{BORDER, Errors, inside};
use crate::pairs::KnownPair;
use crate::section::{Case, Runner, Section};

/// The heading in the report.
pub(crate) const HEADING: &str = "Default settings";

/// Measures everything.
pub(crate) fn run(runner: &mut Runner, data: &Path) -> Vec<Section> {
    let mut sections = vec![scenes::shading(runner), scenes::noise(runner), scenes::accuracy(runner)];
    let (part, part_smoothness, part_sigma) = photographs::part(runner, data);
    let [mut smoothness, mut sigma] = scenes::smoothness_and_sigma(runner);
    smoothness.extend(part_smoothness);
    let ratios = median(smoothness.iter().filter_map(|case| case.get(RATIO)));
    smoothness.push(Case::new("median").at_most(RATIO, ratios, USUAL));
    let (edges, edges_sigma) = depth_edges(runner);
    sigma.extend(edges_sigma);
    sigma.push(part_sigma);
    let what = "Rms of V less the truth, px², by default settings, and by the fixed α that makes it least.";
    sections.push(Section::new("Smoothness", what, smoothness));
    sections.extend([part, photographs::dual_pixel(runner, data), edges]);
    let what = "Shares of the pixels whose error of V is within a multiple of its standard deviation σ.";
    sections.push(Section::new("Sigma", what, sigma));
    // A quick run leaves out some sections.
    sections.retain(|section| !section.cases.is_empty());
    sections
}

const SCENES: [Preset; 3] = [Preset::Card, Preset::Blocks, Preset::Bars];
const KERNELS: [(Kernel, &str); 2] = [(Kernel::Pillbox, "disk"), (Kernel::Gaussian, "gaussian")];

/// Greatest distance of a pixel that is close to an edge, px: twice the radius of the widest disk of these scenes.
const CLOSE: usize = 10;
/// Least jump of V between neighbours that counts as an edge, px². The lowest plate rises by 1.1.
const JUMP: f32 = 0.5;
/// Error of V above which a pixel is wrong, px².
const WRONG: f64 = 1.0;

/// Measures scenes with near edges that hide the background, with a disk and with a Gaussian: the section "Depth
/// edges", and cases of σ.
fn depth_edges(runner: &mut Runner) -> (Section, Vec<Case>) {
    let scenes = if runner.quick { &SCENES[..1] } else { &SCENES[..] };
    let kernels = if runner.quick { &KERNELS[..1] } else { &KERNELS[..] };
    let (mut cases, mut sigma) = (Vec::new(), Vec::new());
    for preset in scenes {
        for (kernel, kernel_name) in kernels {
            let name = format!("{}, {kernel_name}", preset.name());
            let mut scene = Scene { kernel: *kernel, ..preset.scene() };
            if runner.quick {
                (scene.width, scene.height) = (256, 256);
            }
            let mut coverage = None;
            cases.push(runner.case("depth edges", name.clone(), |runner, case| {
                let pair = KnownPair::render(&scene)?;
                let solution = pair.solve(runner, &pair.default_settings())?;
                let errors = Errors::of(&solution, &pair);
                coverage = Some(errors.coverage);
                Ok(away_and_close(case, &solution, &pair.relative_blur).value("corner, px", errors.corner))
            }));
            let failed = || Case::failed(name.clone(), "not solved: see Depth edges");
            sigma.push(coverage.map_or_else(failed, |coverage| coverage.all(Case::new(name.clone()))));
        }
    }
    let what = format!(
        "Layers through a thin lens with occlusion, without noise. Close: within {CLOSE} px of a jump in depth. Wrong: V \
         off by more than {WRONG} px²."
    );
    (Section::new("Depth edges", what, cases), sigma)
}

/// Adds errors of V away from jumps in depth, and close to them.
fn away_and_close(case: Case, solution: &Solution, truth: &[f32]) -> Case {
    let close = close_to_jumps(truth, solution.width as usize);
    let [[away, wrong_away], [near, wrong_near]] =
        [false, true].map(|side| errors(solution, truth, |i| close[i] == side));
    let case = case.value("V rms away, px²", away).value("wrong away, %", wrong_away);
    case.value("V rms close, px²", near).value("wrong close, %", wrong_near)
}

/// Root mean square of the error of V over some pixels, px², and the percentage of wrong pixels.
fn errors(solution: &Solution, truth: &[f32], counts: impl Fn(usize) -> bool) -> [f64; 2] {
    let error = |i: usize| f64::from(solution.relative_blur[i]) - f64::from(truth[i]);
    let pixels = inside(solution.width, solution.height, BORDER).filter(|i| counts(*i));
    let errors: Vec<f64> = pixels.map(error).filter(|e| e.is_finite()).collect();
    let count = errors.len() as f64;
    let wrong = errors.iter().filter(|e| e.abs() > WRONG).count() as f64;
    [(errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt(), 100.0 * wrong / count]
}

/// The pixels within [`CLOSE`] px of a jump in V, along rows and columns.
fn close_to_jumps(relative_blur: &[f32], width: usize) -> Vec<bool> {
    let jumps = |i: usize| {
        let v = relative_blur[i];
        let to = |j: usize| relative_blur.get(j).is_some_and(|other| (v - other).abs() > JUMP);
        (i % width + 1 < width && to(i + 1)) || to(i + width)
    };
    let edges: Vec<bool> = (0..relative_blur.len()).map(jumps).collect();
    let row = |i: usize| i / width * width;
    let along_rows: Vec<bool> = (0..edges.len())
        .map(|i| edges[i.saturating_sub(CLOSE).max(row(i))..(i + CLOSE + 1).min(row(i) + width)].contains(&true))
        .collect();
    let height = edges.len() / width;
    (0..edges.len())
        .map(|i| {
            let (x, y) = (i % width, i / width);
            (y.saturating_sub(CLOSE)..(y + CLOSE + 1).min(height)).any(|y| along_rows[y * width + x])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::{
        Engine, EngineOptions, PairSolver, Settings, SolveOptions, frame::Samples, internals::scene::Shape,
    };

    #[test]
    fn outlines_lie_where_those_of_the_scene_do_in_either_order() {
        let engine =
            Engine::new(&EngineOptions { device: Some("cpu".to_string()), ..EngineOptions::default() }).unwrap();
        for (seed, noise, nearer_first) in [(1, 0.003, true), (2, 0.01, false), (3, 0.003, false)] {
            let mut scene = Scene { width: 256, height: 256, seed, noise, ..Preset::Card.scene() };
            if let (Shape::Layers { lens, .. }, false) = (&mut scene.shape, nearer_first) {
                lens.focus.reverse();
            }
            let pair = scene.render().unwrap();
            let solve = |edges| {
                let settings = Settings { edges, ..Settings::default() };
                PairSolver::new(&engine, &settings)
                    .unwrap()
                    .solve([&pair.i1, &pair.i2], &SolveOptions::default())
                    .unwrap()
            };
            let [before, after] = [false, true].map(solve);
            let close = close_to_jumps(&pair.relative_blur, 256);
            let wrong = |solution: &Solution| errors(solution, &pair.relative_blur, |i| close[i])[1];
            println!("{:.1} % wrong, before {:.1} %", wrong(&after), wrong(&before));
            assert!(wrong(&after) < 0.5 * wrong(&before));
            if !nearer_first {
                // The ground is sharp in I1, with the light of the blurred card over it beyond the rim.
                let mut sharp = Scene { noise: 0.0, ..scene.clone() };
                if let Shape::Layers { lens, .. } = &mut sharp.shape {
                    lens.f_number *= 100.0;
                }
                let [truth, frame] = [sharp.render().unwrap().i1, pair.i1.clone()].map(|frame| match frame.samples() {
                    Samples::F32(values) => values.clone(),
                    _ => panic!("scenes are rendered in floats"),
                });
                let error = |image: &[f32]| {
                    let behind = (0..close.len()).filter(|&i| close[i] && pair.relative_blur[i] > 0.0);
                    let squares: Vec<f64> = behind.map(|i| f64::from(image[i] - truth[i]).powi(2)).collect();
                    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
                };
                let [fused, frame] = [&after.fused, &frame].map(|image| error(image));
                println!("behind the rim: fused {fused:.4}, the better photograph {frame:.4}");
                assert!(fused < 0.75 * frame);
            }
            // Away from edges along x hardly a pixel changes.
            let far = |i: usize| !close[i.saturating_sub(8)] && !close[(i + 8).min(close.len() - 1)];
            let changed = (0..close.len())
                .filter(|&i| far(i) && after.relative_blur[i].to_bits() != before.relative_blur[i].to_bits());
            assert!(changed.count() < close.len() / 50);
        }
        let plane = Scene { width: 96, height: 80, noise: 0.003, ..Preset::Plane.scene() }.render().unwrap();
        let [off, on] = [false, true].map(|edges| {
            let settings = Settings { edges, ..Settings::default() };
            let mut solver = PairSolver::new(&engine, &settings).unwrap();
            let solution = solver.solve([&plane.i1, &plane.i2], &SolveOptions::default()).unwrap();
            [&solution.relative_blur, &solution.uncertainty]
                .map(|field| field.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
        });
        assert!(off == on, "there is no edge");
    }

    #[test]
    fn a_square_around_each_jump_is_close() {
        // A single pixel at (30, 20) differs: there are jumps to and from it in both directions.
        let mut v = vec![0.0; 60 * 40];
        v[20 * 60 + 30] = 2.0;
        let close = close_to_jumps(&v, 60);
        let at = |x: usize, y: usize| close[y * 60 + x];
        assert!(at(30, 20) && at(19, 20) && at(40, 20) && at(30, 9) && at(30, 30) && at(40, 30));
        assert!(!at(18, 20) && !at(41, 20) && !at(30, 8) && !at(30, 31) && !at(19, 9));
    }
}
