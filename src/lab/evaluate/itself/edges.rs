//! Scenes whose near edges hide what lies behind them: V close to these edges, and away from them.

use super::truth::{Errors, Known};
use crate::engine::Solution;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::errors::{BORDER, inside};
use crate::lab::evaluate::section::{Case, Section};
use crate::lab::scene::{Kernel, Preset, Scene};

const SCENES: [Preset; 3] = [Preset::Card, Preset::Blocks, Preset::Bars];
const KERNELS: [(Kernel, &str); 2] = [(Kernel::Pillbox, "disk"), (Kernel::Gaussian, "gaussian")];

/// Close to an edge, px: twice the radius of the widest disk of these scenes.
const CLOSE: usize = 10;
/// V that jumps by more from one pixel to the next has an edge there, px²: the lowest plate rises by 1.1.
const JUMP: f32 = 0.5;
/// V off by more is wrong, px².
const WRONG: f64 = 1.0;

/// A row of the section "Depth edges", and of "Sigma".
pub(super) struct Rows {
    pub accuracy: Case,
    pub sigma: Case,
}

/// Every scene under a disk and under a Gaussian.
pub(super) fn rows(bench: &mut Bench) -> Vec<Rows> {
    let scenes = if bench.quick { &SCENES[..1] } else { &SCENES[..] };
    let kernels = if bench.quick { &KERNELS[..1] } else { &KERNELS[..] };
    let pairs = scenes.iter().flat_map(|preset| kernels.iter().map(move |kernel| (*preset, *kernel)));
    let mut rows = Vec::new();
    for (preset, (kernel, called)) in pairs {
        let name = format!("{}, {called}", preset.name());
        bench.say(&format!("itself: depth edges, {name}"));
        let mut scene = Scene { kernel, ..preset.scene() };
        if bench.quick {
            (scene.width, scene.height) = (256, 256);
        }
        let solved = Known::of(&scene).and_then(|known| one(bench, &name, &known));
        rows.push(solved.unwrap_or_else(|e| Rows {
            accuracy: Case::failed(name.clone(), e.clone()),
            sigma: Case::failed(name, e),
        }));
    }
    rows
}

/// The section of what [`rows`] found.
pub(super) fn section(cases: Vec<Case>) -> Section {
    let what = format!(
        "Layers through a thin lens with occlusion, without noise. Close: within {CLOSE} px of a jump in depth. Wrong: V \
         off by more than {WRONG} px²."
    );
    Section { name: "Depth edges", what, cases }
}

fn one(bench: &mut Bench, name: &str, known: &Known) -> Result<Rows, String> {
    let [i1, i2] = &known.images;
    let solution = bench.solve([i1, i2], &known.settings)?;
    let errors = Errors::of(&solution, &known.transform, &known.relative_blur);
    let close = close_to_jumps(&known.relative_blur, solution.width as usize);
    let [[away, wrong_away], [near, wrong_near]] =
        [false, true].map(|side| off(&solution, &known.relative_blur, |i| close[i] == side));
    let case = Case::new(name).told("V rms away, px²", away).told("wrong away, %", wrong_away);
    let case = case.told("V rms close, px²", near).told("wrong close, %", wrong_near).told("corner, px", errors.corner);
    Ok(Rows { accuracy: case, sigma: errors.sigma.case(name) })
}

/// Root mean square of V's error over the pixels asked for, px², and how many of them are wrong, %.
fn off(solution: &Solution, truth: &[f32], asked: impl Fn(usize) -> bool) -> [f64; 2] {
    let error = |i: usize| f64::from(solution.relative_blur[i]) - f64::from(truth[i]);
    let pixels = inside(solution.width, solution.height, BORDER).filter(|i| asked(*i));
    let errors: Vec<f64> = pixels.map(error).filter(|e| e.is_finite()).collect();
    let count = errors.len() as f64;
    let wrong = errors.iter().filter(|e| e.abs() > WRONG).count() as f64;
    [(errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt(), 100.0 * wrong / count]
}

/// The pixels within [`CLOSE`] px, along rows and columns, of a jump in V.
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

    #[test]
    fn a_square_around_each_jump_is_close() {
        // One pixel that differs, at (30, 20): jumps to and from it, across and down.
        let mut v = vec![0.0; 60 * 40];
        v[20 * 60 + 30] = 2.0;
        let close = close_to_jumps(&v, 60);
        let at = |x: usize, y: usize| close[y * 60 + x];
        assert!(at(30, 20) && at(19, 20) && at(40, 20) && at(30, 9) && at(30, 30) && at(40, 30));
        assert!(!at(18, 20) && !at(41, 20) && !at(30, 8) && !at(30, 31) && !at(19, 9));
    }
}
