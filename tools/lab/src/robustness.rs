//! The accuracy of the methods as a scene gets more difficult, and where they fail.

use parfocal::{
    Frame,
    internals::scene::{Exposure, Preset, Scene, Shape},
    settings::{Kernel, Method},
    transform::Similarity,
};

use crate::errors::spread;
use crate::section::{Case, METHODS, Runner, Section, number, settings};

/// The paper's bound on translation, px. A registration with a larger error counts as failed.
pub(crate) const PAPER_PX: f64 = 0.25;

/// Corner errors as a function of one property of the scene.
pub(crate) struct Curve {
    pub series: &'static Series,
    pub points: Vec<Point>,
}

/// Corner errors at one value of the property: least, median and greatest of the seeds for each method, px.
pub(crate) struct Point {
    pub value: f64,
    pub spreads: [[f64; 3]; METHODS.len()],
}

/// One property of the slanted plane, from easy to difficult.
pub(crate) struct Series {
    pub name: &'static str,
    /// The property and its unit.
    pub quantity: &'static str,
    /// The other properties of the scenes.
    note: &'static str,
    pub logarithmic: bool,
    values: &'static [f64],
    scene: fn(f64) -> Scene,
}

static SERIES: [Series; 5] = [
    Series {
        name: "noise",
        quantity: "noise σ, white = 1",
        note: "Noise in both images.",
        logarithmic: false,
        values: &[0.0, 0.005, 0.01, 0.02, 0.05],
        scene: |noise| Scene { noise, ..plane() },
    },
    Series {
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
    Series {
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
    Series {
        name: "blur",
        quantity: "largest σ of the blur, px",
        note: "V from σ² to -σ². The plane is 256 px high, and 256 to 1024 px wide: the more blur, the wider. The method \
               takes V for constant within a window, which is the less true the steeper V is.",
        logarithmic: false,
        values: &[1.0, 2.0, 4.0, 6.0, 8.0, 11.0],
        scene: |sigma| {
            let limit = sigma * sigma;
            let width = if limit <= 4.0 { 256 } else { 1024.min(32 * limit as u32) };
            Scene { width, shape: Shape::Plane { limit }, ..plane() }
        },
    },
    Series {
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

/// Runs every series.
pub(crate) fn run(runner: &mut Runner) -> Vec<Curve> {
    SERIES.iter().map(|series| curve(runner, series)).collect()
}

fn curve(runner: &mut Runner, series: &'static Series) -> Curve {
    let values = if runner.quick { &series.values[1..2] } else { series.values };
    let mut points = Vec::new();
    for &value in values {
        runner.log(&format!("robustness: {}, {value}", series.name));
        points.push(point(runner, series, value));
    }
    Curve { series, points }
}

fn point(runner: &mut Runner, series: &Series, value: f64) -> Point {
    let seeds = if runner.quick { &SEEDS[..1] } else { &SEEDS };
    let mut corners = METHODS.map(|_| Vec::new());
    for &seed in seeds {
        let mut scene = Scene { seed, ..(series.scene)(value) };
        if runner.quick {
            (scene.width, scene.height) = (scene.width / 2, scene.height / 2);
        }
        let pair = scene.render();
        for (method, corners) in METHODS.into_iter().zip(&mut corners) {
            let corner = pair.as_ref().ok().and_then(|pair| {
                let found = register(runner, [&pair.i1, &pair.i2], method)?;
                Some(found.corner_distance(&pair.transform, scene.width, scene.height)).filter(|c| c.is_finite())
            });
            corners.push(corner);
        }
    }
    Point { value, spreads: corners.map(|corners| spread(&corners)) }
}

/// Registers only; `None` if the method fails.
fn register(runner: &mut Runner, pair: [&Frame; 2], method: Method) -> Option<Similarity> {
    runner.register(pair, &settings(method, &Kernel::Gaussian)).ok().map(|registered| registered.transform.at_centre())
}

impl Curve {
    /// The medians as a table, and the value at which each method fails.
    pub(crate) fn section(&self) -> Section {
        let Series { name, quantity, note, .. } = self.series;
        let row = |case: Case, value: &dyn Fn(usize) -> Option<f64>| {
            METHODS.iter().enumerate().fold(case, |case, (m, method)| case.value(method.name(), value(m)))
        };
        let point = |point: &Point| {
            let spreads = METHODS.iter().zip(&point.spreads);
            let spreads = spreads.map(|(m, s)| format!("{} {} to {}", m.name(), number(s[0]), number(s[2])));
            row(Case::new(point.value.to_string()), &|m| Some(point.spreads[m][1]))
                .note(spreads.collect::<Vec<_>>().join(", "))
        };
        let mut cases: Vec<Case> = self.points.iter().map(point).collect();
        cases.push(row(Case::new("holds to"), &|m| self.edge(m)[0]));
        cases.push(row(Case::new("fails at"), &|m| self.edge(m)[1]));
        let what = format!(
            "{note} Corner error of the slanted plane, 256 x 256 px, V ±4 px², by {quantity}: median over the seeds, px \
             (least to greatest in the note); registration alone. A method fails where its median first exceeds \
             {PAPER_PX} px, the paper's bound."
        );
        Section::without_bounds(format!("Robustness: {name}"), what, cases)
    }

    /// The last value before a method's median first exceeds the paper's bound, and the value at which it does.
    fn edge(&self, method: usize) -> [Option<f64>; 2] {
        let within = self.points.iter().take_while(|point| point.spreads[method][1] <= PAPER_PX).count();
        let value = |i: usize| self.points.get(i).map(|point| point.value);
        [within.checked_sub(1).and_then(value), value(within)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_fails_at_the_first_value_beyond_the_bound() {
        let point = |value: f64, corner: Option<f64>| Point { value, spreads: [spread(&[corner]); METHODS.len()] };
        let values = [(1.0, Some(0.1)), (2.0, Some(0.25)), (3.0, None), (4.0, Some(0.1))];
        let edge = |values: &[(f64, Option<f64>)]| {
            let points = values.iter().map(|(value, corner)| point(*value, *corner)).collect();
            Curve { series: &SERIES[0], points }.edge(0)
        };
        assert_eq!(edge(&values), [Some(2.0), Some(3.0)]);
        assert_eq!(edge(&values[..2]), [Some(2.0), None]);
        assert_eq!(edge(&values[2..]), [None, Some(3.0)]);
    }

    #[test]
    fn every_scene_of_every_series_can_be_rendered() {
        for series in &SERIES {
            for value in series.values {
                (series.scene)(*value).check().unwrap();
            }
        }
    }
}
