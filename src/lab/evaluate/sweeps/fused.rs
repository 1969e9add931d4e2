//! Compares the sharpness of the fused image with the sharpest frame at each place.

use std::path::Path;

use super::super::runner::Runner;
use super::super::section::{Case, Section};
use super::{FRAMES, solve_counted};
use crate::base::{Error, Frame};
use crate::files::image_io;
use crate::lab::scene::{Preset, Scene, SweepScene};
use crate::solve::resample::{brightened, luminance, onto};
use crate::solve::sweep::Sweep;

/// Standard deviation of the noise of simulated sweeps, white = 1.
const NOISE: f64 = 0.003;
/// Size of a quick run, px.
const SMALL: [u32; 2] = [160, 128];
/// Folder within the data folder, and the numbers of the frames.
const HEAT_SINK: &str = "heatsink";
const NUMBERS: [u32; 7] = [10, 15, 20, 25, 30, 35, 40];
/// Side of a tile, px.
const TILE: usize = 32;
/// Least ratio of the variances of the Laplacian between two frames for a tile to count as textured. In other tiles
/// focus makes no difference.
const TEXTURED: f64 = 4.0;
/// The share of the sharpest frame's variance that a tile must reach, and the share of tiles that must reach it, %.
const SHARP: f64 = 0.95;
const ENOUGH: f64 = 99.0;

/// Measures the heat sink, and simulated sweeps with edges that hide what is behind them.
pub(super) fn section(runner: &mut Runner, data: &Path) -> Section {
    let presets = [Preset::Card, Preset::Blocks, Preset::Bars];
    let presets = if runner.quick { &presets[..1] } else { &presets[..] };
    let simulated = |preset: &Preset| {
        let mut scene = Scene { noise: NOISE, ..preset.scene() };
        if runner.quick {
            [scene.width, scene.height] = SMALL;
        }
        runner.case("sweeps: fused image", scene.name.clone(), |runner, case| {
            let frames = SweepScene::new(scene, FRAMES).render().map_err(|e| e.to_string())?.frames;
            Ok(judge(case, &solve_counted(runner, &frames)?, &frames))
        })
    };
    let mut cases: Vec<Case> = presets.iter().map(simulated).collect();
    if !runner.quick {
        cases.push(runner.case("sweeps: fused image", "heat sink", |runner, case| {
            let read = NUMBERS.iter().map(|n| image_io::read(&data.join(HEAT_SINK).join(format!("frame_{n}.png"))));
            let frames = read.collect::<Result<Vec<Frame>, Error>>().map_err(|e| e.to_string())?;
            Ok(judge(case, &solve_counted(runner, &frames)?, &frames))
        }));
    }
    let what = format!(
        "Variance of the Laplacian in tiles of {TILE} px against that of the sharpest frame there, registered by a cubic \
         spline. A tile has texture where one frame has {TEXTURED} times the variance of another: the share of these tiles \
         with {SHARP} of the sharpest frame's; of the other tiles, the median share. Simulated sweeps of {FRAMES} frames, \
         noise {NOISE}, and the seven frames of the heat sink, by default settings."
    );
    Section::new("Fused image", what, cases)
}

fn judge(case: Case, sweep: &Sweep, frames: &[Frame]) -> Case {
    let size = [sweep.width as usize, sweep.height as usize];
    let registered = |n: usize| {
        let values = luminance(brightened(&frames[n], &sweep.brightness[n], sweep.decode), frames[n].format().channels);
        variances(&onto(values, 1, &sweep.transforms[n], size), size)
    };
    let frames: Vec<Vec<f64>> = (0..frames.len()).map(registered).collect();
    let fused = variances(&luminance(sweep.fused.clone(), sweep.fused_channels), size);
    let (textured, flat) = shares(&frames, &fused);
    let sharp = 100.0 * textured.iter().filter(|share| **share >= SHARP).count() as f64 / textured.len() as f64;
    let case = case.within("as sharp as the sharpest frame, % of tiles", sharp, [ENOUGH, 100.0]);
    let case = case.value("least share of a tile", textured.iter().copied().reduce(f64::min));
    let note = format!("{} tiles with texture, {} without", textured.len(), flat.len());
    case.value("share of the median tile without texture", median(flat)).note(note)
}

/// The variance of each tile in the fused image over that in the sharpest frame, for tiles with and without texture.
fn shares(frames: &[Vec<f64>], fused: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut textured, mut flat) = (Vec::new(), Vec::new());
    for (tile, fused) in fused.iter().enumerate() {
        let variances = || frames.iter().map(|frame| frame[tile]).filter(|variance| variance.is_finite());
        let (most, least) = (variances().fold(0.0, f64::max), variances().fold(f64::INFINITY, f64::min));
        if most > 0.0 {
            (if most >= TEXTURED * least { &mut textured } else { &mut flat }).push(fused / most);
        }
    }
    (textured, flat)
}

/// The variance of the Laplacian in each whole tile; NaN if a pixel is NaN.
fn variances(values: &[f32], [width, height]: [usize; 2]) -> Vec<f64> {
    let at = |x: usize, y: usize| f64::from(values[y.min(height - 1) * width + x.min(width - 1)]);
    let laplacian = |x: usize, y: usize| {
        at(x.saturating_sub(1), y) + at(x + 1, y) + at(x, y.saturating_sub(1)) + at(x, y + 1) - 4.0 * at(x, y)
    };
    let of_tile = |left: usize, top: usize| {
        let pixels = || (0..TILE * TILE).map(|n| laplacian(left + n % TILE, top + n / TILE));
        let mean = pixels().sum::<f64>() / (TILE * TILE) as f64;
        pixels().map(|l| (l - mean).powi(2)).sum::<f64>() / (TILE * TILE) as f64
    };
    let places = (0..height / TILE).flat_map(|row| (0..width / TILE).map(move |column| (column, row)));
    places.map(|(column, row)| of_tile(TILE * column, TILE * row)).collect()
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_compared_with_the_sharpest_frame_that_shows_them() {
        // Checks of ±a have a Laplacian of ±8a, with the variance 64 a².
        let checks =
            |a: f32| (0..64 * 32).map(|i| if (i % 64 + i / 64) % 2 == 0 { a } else { -a }).collect::<Vec<f32>>();
        let found = variances(&checks(0.5), [64, 32]);
        // The Laplacian is smaller at the border.
        assert!(found.len() == 2 && found.iter().all(|v| (14.0..16.1).contains(v)), "{found:?}");
        let mut hidden = checks(0.5);
        hidden[5] = f32::NAN;
        assert!(variances(&hidden, [64, 32])[0].is_nan());
        let frames = [vec![4.0, 1.0, f64::NAN], vec![1.0, 1.1, 2.0]];
        assert_eq!(shares(&frames, &[3.8, 1.1, 1.0]), (vec![0.95], vec![1.0, 0.5]));
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(Vec::new())), (Some(2.0), None));
    }
}
