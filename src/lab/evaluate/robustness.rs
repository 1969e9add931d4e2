//! How the registration fares as a scene gets harder, and where it ends.

use serde::Serialize;

use super::bench::{Bench, SYSTEMS, settings};
use super::errors::Spread;
use crate::base::{Kernel, Method, Similarity};
use crate::lab::scene::{Exposure, Preset, Scene, Shape};

/// The paper's bound on translation, px: beyond it a registration counts as failed.
pub(super) const PAPER_PX: f64 = 0.25;

/// One property of the scene, from easy to hard.
#[derive(Serialize)]
pub(super) struct Sweep {
    pub name: &'static str,
    /// What is swept, and its unit.
    pub quantity: &'static str,
    /// What else is to be known of the scenes.
    pub note: &'static str,
    /// Whether the axis is logarithmic.
    pub logarithmic: bool,
    pub points: Vec<Point>,
    pub edges: Vec<Edge>,
}

/// One value of the property.
#[derive(Serialize)]
pub(super) struct Point {
    pub value: f64,
    pub systems: Vec<Samples>,
}

/// One system at one value, over the seeds.
#[derive(Serialize)]
pub(super) struct Samples {
    pub system: &'static str,
    /// The largest corner error of each seed, px; `null` where the system failed.
    pub corner_px: Vec<Option<f64>>,
    pub spread: Spread,
}

/// Where the working range of a system ends.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Edge {
    pub system: &'static str,
    /// The hardest value up to which every median is at most 0.25 px at the corners.
    pub holds_to: Option<f64>,
    /// The next value, at which it is not; `null` where the sweep ends before.
    pub fails_at: Option<f64>,
}

/// Describes a sweep: its scenes, from easy to hard.
struct Plan {
    name: &'static str,
    quantity: &'static str,
    note: &'static str,
    logarithmic: bool,
    values: &'static [f64],
    scene: fn(f64) -> Scene,
}

const PLANS: [Plan; 5] = [
    Plan {
        name: "noise",
        quantity: "noise σ, white = 1",
        note: "Noise in both images.",
        logarithmic: false,
        values: &[0.0, 0.005, 0.01, 0.02, 0.05],
        scene: |noise| Scene { noise, ..plane() },
    },
    Plan {
        name: "exposure",
        quantity: "I2 darker by, %",
        note: "I2 <- (1 - e) I2 + 0.05 e.",
        logarithmic: false,
        values: &[0.0, 5.0, 10.0, 20.0, 30.0, 60.0],
        scene: |percent| {
            let exposure = Exposure { gain: 1.0 - percent / 100.0, offset: 0.05 * percent / 100.0 };
            Scene { exposure, ..plane() }
        },
    },
    Plan {
        name: "misalignment",
        quantity: "translation, % of the width",
        note: "The length of the translation, along (4, -3)/5; rotation 0.15°, scale 1 %.",
        logarithmic: false,
        values: &[0.5, 2.0, 5.0, 10.0, 15.0, 20.0],
        scene: |percent| {
            let scene = plane();
            let length = percent / 100.0 * f64::from(scene.width);
            Scene { transform: Similarity::new(0.8 * length, -0.6 * length, 0.15, 1.01), ..scene }
        },
    },
    Plan {
        name: "blur",
        quantity: "largest σ of the blur, px",
        note: "V from σ² to -σ². The plane is 256 px high and the wider the more blur there is, 256 to 1024 px: V is \
               taken for constant within a window, which is the less true the steeper V is.",
        logarithmic: false,
        values: &[1.0, 2.0, 4.0, 6.0, 8.0, 11.0],
        scene: |sigma| {
            let limit = sigma * sigma;
            let width = if limit <= 4.0 { 256 } else { 1024.min(32 * limit as u32) };
            Scene { width, shape: Shape::Plane { limit }, ..plane() }
        },
    },
    Plan {
        name: "contrast",
        quantity: "contrast, white less black",
        note: "Noise σ 0.003 in both images.",
        logarithmic: true,
        values: &[0.9, 0.3, 0.1, 0.03, 0.01],
        scene: |contrast| Scene { contrast, noise: 0.003, ..plane() },
    },
];

fn plane() -> Scene {
    Preset::Plane.scene()
}

/// Seeds of texture and noise.
const SEEDS: [u64; 3] = [1, 2, 3];

/// Runs every sweep.
pub(super) fn run(bench: &mut Bench) -> Vec<Sweep> {
    PLANS.iter().map(|plan| sweep(bench, plan)).collect()
}

fn sweep(bench: &mut Bench, plan: &Plan) -> Sweep {
    let values = if bench.quick { &plan.values[1..2] } else { plan.values };
    let mut points = Vec::new();
    for &value in values {
        bench.say(&format!("robustness: {}, {value}", plan.name));
        points.push(point(bench, plan, value));
    }
    let edges = SYSTEMS.map(|system| edge(&points, system.name())).into();
    let Plan { name, quantity, note, logarithmic, .. } = *plan;
    Sweep { name, quantity, note, logarithmic, points, edges }
}

fn point(bench: &mut Bench, plan: &Plan, value: f64) -> Point {
    let seeds = if bench.quick { &SEEDS[..1] } else { &SEEDS };
    let mut corners = SYSTEMS.map(|_| Vec::new());
    for &seed in seeds {
        let mut scene = Scene { seed, ..(plan.scene)(value) };
        if bench.quick {
            (scene.width, scene.height) = (scene.width / 2, scene.height / 2);
        }
        let pair = scene.render();
        for (system, corners) in SYSTEMS.iter().zip(&mut corners) {
            let corner = pair.as_ref().ok().and_then(|pair| {
                let found = register(bench, [&pair.i1, &pair.i2], *system)?;
                Some(found.corner_distance(&pair.transform, scene.width, scene.height)).filter(|c| c.is_finite())
            });
            corners.push(corner);
        }
    }
    let samples = SYSTEMS.iter().zip(corners).map(|(system, corner_px)| Samples {
        system: system.name(),
        spread: Spread::of(&corner_px),
        corner_px,
    });
    Point { value, systems: samples.collect() }
}

/// Registration alone; `None` where the system fails.
fn register(bench: &mut Bench, pair: [&crate::base::Frame; 2], system: Method) -> Option<Similarity> {
    bench.register(pair, &settings(system, &Kernel::Gaussian)).ok().map(|registered| registered.transform.at_centre())
}

fn edge(points: &[Point], system: &'static str) -> Edge {
    let holds =
        |point: &&Point| point.systems.iter().find(|s| s.system == system).is_some_and(|s| s.spread.median <= PAPER_PX);
    let within = points.iter().take_while(holds).count();
    let value = |i: usize| points.get(i).map(|point| point.value);
    Edge { system, holds_to: within.checked_sub(1).and_then(value), fails_at: value(within) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_is_the_last_value_before_the_first_failure() {
        let point = |value: f64, corner: Option<f64>| {
            let corner_px = vec![corner];
            Point { value, systems: vec![Samples { system: "sift", spread: Spread::of(&corner_px), corner_px }] }
        };
        let points = [point(1.0, Some(0.1)), point(2.0, Some(0.25)), point(3.0, None), point(4.0, Some(0.1))];
        assert_eq!(edge(&points, "sift"), Edge { system: "sift", holds_to: Some(2.0), fails_at: Some(3.0) });
        assert_eq!(edge(&points[..2], "sift").fails_at, None);
        assert_eq!(edge(&points[2..], "sift"), Edge { system: "sift", holds_to: None, fails_at: Some(3.0) });
    }

    #[test]
    fn every_scene_of_every_sweep_can_be_rendered() {
        for plan in PLANS {
            for value in plan.values {
                (plan.scene)(*value).check().unwrap();
            }
        }
    }
}
