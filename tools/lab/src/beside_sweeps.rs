//! V of two photographs of a real sweep, compared with what the focus of all frames says of it.

use std::path::Path;

use parfocal::{
    Error, Frame, Settings, SolveOptions, image_io,
    internals::median,
    internals::stages::uncertainty::LARGEST,
    sweep::{Positions, Sweep, SweepOptions, SweepSolver},
};

use crate::errors::Coverage;
use crate::section::{Case, Runner, Section};

/// A sweep of photographs, and the pairs of it that are solved.
struct RealSweep {
    name: &'static str,
    /// The names of its files before and after the number.
    file: [&'static str; 2],
    /// The digits of the number.
    digits: usize,
    numbers: &'static [u32],
    pairs: &'static [[u32; 2]],
}

const SWEEPS: [RealSweep; 3] = [
    RealSweep {
        name: "dimple",
        file: ["image", ".jpg"],
        digits: 2,
        numbers: &[3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
        pairs: &[[6, 10], [7, 9], [8, 9], [5, 11], [3, 8]],
    },
    RealSweep {
        name: "heatsink",
        file: ["frame_", ".png"],
        digits: 2,
        numbers: &[10, 15, 20, 25, 30, 35, 40],
        pairs: &[[15, 30], [20, 35]],
    },
    RealSweep {
        name: "metal-part",
        file: ["sweep_", ".png"],
        digits: 2,
        numbers: &[2, 4, 6, 10, 12, 14, 16, 20, 22, 24, 26, 28, 30],
        pairs: &[[6, 16], [12, 22], [4, 14]],
    },
];

/// Bounds on the median of V over that by the sweep.
const RATIO: [f64; 2] = [0.95, 1.05];

impl RealSweep {
    fn read(&self, data: &Path) -> Result<Vec<Frame>, String> {
        let file = |n: &u32| format!("{}{n:0digits$}{}", self.file[0], self.file[1], digits = self.digits);
        let frames = self.numbers.iter().map(|n| image_io::read(&data.join(self.name).join(file(n))));
        frames.collect::<Result<_, Error>>().map_err(|e| e.to_string())
    }
}

/// Measures all pairs.
pub(crate) fn section(runner: &mut Runner, data: &Path) -> Section {
    let mut cases = Vec::new();
    for real in &SWEEPS {
        let frames = real.read(data);
        for pair in real.pairs {
            let name = format!("{}, frames {} and {}", real.name, pair[0], pair[1]);
            cases.push(runner.case("pairs beside their sweeps", name, |runner, case| {
                let indices = pair.map(|n| real.numbers.iter().position(|k| *k == n).expect("a frame of the sweep"));
                compare(runner, case, frames.as_ref()?, real.numbers, indices)
            }));
        }
    }
    let what = "Photographs a and b of a real sweep, solved by default settings, against u of all its frames on the grid \
                of a: V should be c ((b - u)² - (a - u)²). The deviations of both count; pixels that either does not \
                measure are left out. The ratio is that of V to the sweep's in the median, where the sweep's is more than \
                half of its ninth decile. By the Gaussian: V of the same pair under a stated Gaussian, by the law of the \
                paper.";
    Section::new("Pairs beside their sweeps", what, cases)
}

/// Solves the sweep on the grid of frame a, and the pair, and compares them.
fn compare(
    runner: &mut Runner,
    case: Case,
    frames: &[Frame],
    numbers: &[u32],
    [a, b]: [usize; 2],
) -> Result<Case, String> {
    let positions = Positions::Settings(numbers.iter().map(|n| f64::from(*n)).collect());
    let options = SweepOptions { positions, reference: Some(a), ..SweepOptions::default() };
    let solved = SweepSolver::new(runner.engine, &options).and_then(|mut s| s.solve(frames, &SolveOptions::default()));
    let sweep: Sweep = solved.map_err(|e| e.to_string())?;
    let [from, to] = [a, b].map(|n| f64::from(numbers[n]));
    // V by the sweep, and its standard deviation, at each pixel.
    let expected = |i: usize| {
        let (u, deviation) = (f64::from(sweep.focus[i]), f64::from(sweep.uncertainty[i]));
        let v = sweep.blur_rate * ((to - u).powi(2) - (from - u).powi(2));
        [v, 2.0 * sweep.blur_rate * (to - from).abs() * deviation]
    };
    let mut large: Vec<f64> = (0..sweep.focus.len()).map(|i| expected(i)[0].abs()).filter(|v| v.is_finite()).collect();
    large.sort_by(f64::total_cmp);
    let large = 0.5 * large.get(large.len() * 9 / 10).copied().unwrap_or(f64::INFINITY);
    let mut solve = |settings: Settings| {
        let solution = runner.solve([&frames[a], &frames[b]], &settings)?;
        let measured: Vec<usize> = (0..sweep.focus.len())
            .filter(|&i| sweep.focus[i].is_finite() && solution.uncertainty[i] < LARGEST)
            .collect();
        let v = |i: usize| f64::from(solution.relative_blur[i]);
        let errors = measured.iter().map(|&i| {
            let [expected, deviation] = expected(i);
            (v(i) - expected, deviation.hypot(f64::from(solution.uncertainty[i])))
        });
        let ratios = measured.iter().map(|&i| v(i) / expected(i)[0]);
        let counted = measured.iter().map(|&i| expected(i)[0].abs() > large);
        let ratio = median(ratios.zip(counted).filter(|(_, counts)| *counts).map(|(ratio, _)| ratio));
        let scatter = median(measured.iter().map(|&i| (v(i) - ratio.unwrap_or(1.0) * expected(i)[0]).abs()));
        let energy = solution.levels.last().and_then(|level| level.energy.last()).copied();
        Ok::<_, String>((Coverage::of(errors), ratio, scatter, energy, solution))
    };
    let (coverage, ratio, scatter, energy, solution) = solve(Settings::default())?;
    let (_, _, gaussian_scatter, gaussian_energy, _) =
        solve(Settings { kernel: parfocal::settings::Kernel::Gaussian, ..Settings::default() })?;
    let over = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a / b);
    let shape = if solution.kernel_shape == Some(0.0) { "Gaussian" } else { "disk" };
    let law = solution.separation.map_or("relative".into(), |p| format!("lens, {p:.1} px²"));
    Ok(coverage
        .all(case)
        .within("V over the sweep's", ratio, RATIO)
        .value("scatter, of that by the Gaussian", over(scatter, gaussian_scatter))
        .value("energy, of that by the Gaussian", over(energy, gaussian_energy))
        .note(format!("{shape}, {law}, scale known to {:.0} %", 100.0 * solution.scale_deviation)))
}
