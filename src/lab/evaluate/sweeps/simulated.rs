//! A simulated sweep that breathes, drifts, turns, brightens and vignettes.

use super::truth::{judged, solved};
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::errors::{BORDER, inside};
use crate::lab::evaluate::section::{Case, Section};
use crate::lab::scene::{Preset, Scene, Shot, SimulatedSweep, SweepScene};
use crate::solve::focus_stack::Sweep;

const FRAMES: usize = 11;
/// Deviation of the noise, white = 1.
const NOISE: f64 = 0.005;
/// Of a quick run.
const SMALL: [u32; 2] = [160, 120];
/// Bounds: a corner, px, and the median error, frames.
const CORNER: f64 = 0.05;
const MOST: f64 = 0.1;

/// One sweep.
pub(super) fn section(bench: &mut Bench) -> Section {
    let mut scene = Scene { noise: NOISE, ..Preset::Relief.scene() };
    if bench.quick {
        [scene.width, scene.height] = SMALL;
    }
    let asked = SweepScene {
        breathing: 0.05,
        drift: 10.0,
        rotation: 0.3f64.to_radians(),
        gain_drift: 0.05,
        vignetting: 0.06,
        ..SweepScene::new(scene, FRAMES)
    };
    let name = format!("{}, {FRAMES} frames", asked.scene.name);
    bench.say(&format!("sweeps: {name}"));
    let case = case(bench, &asked, name.clone()).unwrap_or_else(|e| Case::failed(name, e));
    let what = "A rendered sweep that breathes by 5 %, drifts by 10 px, turns by 0.3°, brightens by ±5 % and vignettes \
                by ±6 %, noise 0.005, by default settings: where the worst frame is put at a corner, and the focus, 16 px along the border left \
                out."
        .to_string();
    Section { name: "Simulated sweep", what, cases: vec![case] }
}

fn case(bench: &mut Bench, asked: &SweepScene, name: String) -> Result<Case, String> {
    let simulated = asked.render().map_err(|e| e.to_string())?;
    let SimulatedSweep { frames, shots, focus, .. } = &simulated;
    let sweep = solved(bench.engine(), frames, shots.iter().map(|shot| shot.position).collect())?;
    let pixels: Vec<usize> = inside(sweep.width, sweep.height, BORDER).collect();
    let case =
        judged(&sweep, focus, &pixels, name, MOST).at_most("worst corner, px", worst_corner(&sweep, shots), CORNER);
    Ok(case.note(format!("c {:.4} px², true {:.4}", sweep.blur_rate, asked.blur_rate)))
}

/// How far off the corner of any frame is, px.
fn worst_corner(sweep: &Sweep, shots: &[Shot]) -> f64 {
    let both = sweep.transforms.iter().zip(shots);
    both.map(|(t, shot)| t.corner_distance(shot.transform, sweep.width, sweep.height)).fold(0.0, f64::max)
}
