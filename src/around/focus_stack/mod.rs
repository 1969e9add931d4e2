//! A focus sweep: more than two photographs of one scene, each focused a little further, to one map of where every
//! pixel is in focus and one image sharp all over.
//!
//! Each frame and the next are solved as a pair ([`Solver`]), which registers them too. Their relative blurs are combined
//! on the pixels of one frame, the reference (`combine.rs` has the model): a point that is blurred too widely in one pair
//! is decided by the pairs between whose frames it comes into focus.

mod combine;
mod fuse;
mod position;

use self::combine::Observation;
pub use self::position::{Positions, SweepDepth};
use crate::around::resample::{Interleaved, Interpolation, onto};
use crate::base::{Brightness, Channels, Decode, Error, Frame, Homography, Photometric, Settings, Shading, centre};
use crate::engine::{Engine, Solution, Solver};

/// How a sweep is solved.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// Settings of each pair.
    pub settings: Settings,
    /// What the frames are focused at.
    pub positions: Positions,
    /// The frame on whose pixels the results are; `None` takes the middle one.
    pub reference: Option<usize>,
}

impl SweepOptions {
    /// Checks what can be said before any photograph is read: that a sweep of so many frames has these positions and this
    /// reference.
    ///
    /// # Errors
    /// [`Error::Mismatch`]; those of [`Settings::check`].
    pub fn check(&self, frames: usize) -> Result<(), Error> {
        let mismatch = |problem: String| Err(Error::Mismatch(problem));
        if frames < 3 {
            return mismatch(format!(
                "a sweep has three frames or more, not {frames}; solve a pair with parfocal solve"
            ));
        }
        if let Some(n) = self.reference.filter(|&reference| reference >= frames) {
            return mismatch(format!("there is no reference frame {}, counted from 1: there are {frames}", n + 1));
        }
        self.settings.check()?;
        self.positions.check(frames)
    }
}

/// Where a scene is in focus.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// Pixels a row, of every field below.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The focus setting at which each pixel of the reference is sharp; NaN where no pair tells.
    pub focus: Vec<f32>,
    /// Its standard deviation, in settings.
    pub uncertainty: Vec<f32>,
    /// Depth in mm, where the positions are in mm.
    pub depth: Option<SweepDepth>,
    /// Grey only if all frames are.
    pub fused_channels: Channels,
    /// The all-in-focus image, interleaved, in the values of the reference with white at 1.
    pub fused: Vec<f32>,
    /// The frame on whose pixels the results are.
    pub reference: usize,
    /// The focus setting of each frame, in which blur is linear.
    pub positions: Vec<f64>,
    /// What the frames are focused at, as stated.
    pub stated: Positions,
    /// Where each pixel of the reference lies in each frame.
    pub transforms: Vec<Homography>,
    /// What brings each frame to the reference's brightness.
    pub brightness: Vec<Brightness>,
    /// c: by how many px² of variance blur grows with the squared distance from the focus, in settings.
    pub blur_rate: f64,
    /// How stored values became intensities.
    pub decode: Decode,
    /// Of each pair of neighbours what speaks against it; a sentence each.
    pub warnings: Vec<String>,
}

/// Solves a sweep; `say` is told how many of the pairs are done.
///
/// # Errors
/// [`Error::Mismatch`]: fewer than three frames, sizes or formats that differ, positions that do not fit, or blur that
/// does not behave like a sweep's. Those of [`Solver::solve`].
pub fn solve_sweep(
    engine: &Engine,
    frames: &[Frame],
    options: &SweepOptions,
    say: &mut dyn FnMut(usize, usize),
) -> Result<Sweep, Error> {
    check(frames, options)?;
    let reference = options.reference.unwrap_or(frames.len() / 2);
    let solutions = solve_pairs(engine, frames, &options.settings, say)?;
    let steps: Vec<_> = solutions.iter().map(|solution| (solution.transform, solution.brightness())).collect();
    let (transforms, brightness) = chained(&steps, reference);
    let warnings = warnings(&solutions);
    let settings = options.positions.settings(frames.len());
    let step = mean_step(&settings);
    // Weights of the smoothness are for settings a step apart, so counted they are combined.
    let counted: Vec<f64> = settings.iter().map(|p| (p - settings[0]) / step).collect();
    let limit = options.settings.max_relative_blur as f32;
    let mut pairs = Vec::new();
    for ((solution, t), p) in solutions.into_iter().zip(&transforms).zip(counted.windows(2)) {
        pairs.push(observation(&solution, t, [p[0], p[1]], limit));
    }
    let blur_rate = combine::blur_rate(&pairs).ok_or_else(|| {
        Error::Mismatch(
            "the frames do not come into focus one after the other: see that they are in the order of their focus, \
             and that they overlap in depth (each point sharp enough in two frames)"
                .to_string(),
        )
    })?;
    let (width, height) = (frames[0].width(), frames[0].height());
    let found = combine::combine(pairs, blur_rate, width as usize);
    let (counts, deviations): (Vec<f32>, Vec<f32>) = found.iter().map(|&[u, s]| (u, s)).unzip();
    let placed = fuse::Placed { transforms: &transforms, brightness: &brightness, positions: &counted };
    let (fused, fused_channels) = fuse::fuse(frames, &placed, reference, &counts, options.settings.decode);
    let focus: Vec<f32> = counts.iter().map(|&u| (settings[0] + step * f64::from(u)) as f32).collect();
    let uncertainty: Vec<f32> = deviations.iter().map(|&s| (step.abs() * f64::from(s)) as f32).collect();
    Ok(Sweep {
        width,
        height,
        depth: options.positions.depth(&focus, &uncertainty),
        focus,
        uncertainty,
        fused_channels,
        fused,
        reference,
        positions: settings,
        stated: options.positions.clone(),
        transforms,
        brightness,
        blur_rate: blur_rate / (step * step),
        decode: options.settings.decode,
        warnings,
    })
}

/// Each frame and the next. Of so many only V and its deviation are kept.
fn solve_pairs(
    engine: &Engine,
    frames: &[Frame],
    settings: &Settings,
    say: &mut dyn FnMut(usize, usize),
) -> Result<Vec<Solution>, Error> {
    let mut solver = Solver::for_pair(engine, &frames[0], &frames[1], settings)?;
    let mut solutions = Vec::new();
    for (n, pair) in frames.windows(2).enumerate() {
        let mut solution = solver.solve(&pair[0], &pair[1])?;
        (solution.fused, solution.confidence, solution.residual) = (Vec::new(), Vec::new(), Vec::new());
        solutions.push(solution);
        say(n + 1, frames.len() - 1);
    }
    Ok(solutions)
}

/// The mean step from setting to setting, negative where they descend.
fn mean_step(settings: &[f64]) -> f64 {
    (settings[settings.len() - 1] - settings[0]) / (settings.len() - 1) as f64
}

/// Whether frames and options fit each other.
fn check(frames: &[Frame], options: &SweepOptions) -> Result<(), Error> {
    let mismatch = |problem: String| Err(Error::Mismatch(problem));
    options.check(frames.len())?;
    let first = (frames[0].width(), frames[0].height(), frames[0].format());
    if let Some(n) = frames.iter().position(|f| (f.width(), f.height(), f.format()) != first) {
        let found = &frames[n];
        return mismatch(format!(
            "frame {} is {}x{} {:?} and the first {}x{} {:?}: a sweep's frames have one size and format",
            n + 1,
            found.width(),
            found.height(),
            found.format(),
            first.0,
            first.1,
            first.2
        ));
    }
    Ok(())
}

/// From the reference to each frame, by way of those between; brightness the other way.
fn chained(steps: &[(Homography, Brightness)], reference: usize) -> (Vec<Homography>, Vec<Brightness>) {
    let part = steps[0].1.part;
    let size = [part.width, part.height];
    let frames = steps.len() + 1;
    let (mut transforms, mut chain) = (vec![Homography::IDENTITY; frames], vec![Brightness::unchanged(size); frames]);
    let middle = centre(size[0], size[1]);
    for k in reference..steps.len() {
        let ((transform, inner), outer) = (steps[k], chain[k]);
        transforms[k + 1] = transform.after(&transforms[k]);
        let back = transform.inverse();
        let factor = |place| outer.factor(back.apply(place, middle)) * inner.factor(place);
        let (a, b) = (outer.photometric, inner.photometric);
        chain[k + 1] = shaded(size, a.gain * b.gain, a.gain * b.offset + a.offset, factor);
    }
    for k in (0..reference).rev() {
        let ((transform, inner), outer) = (steps[k], chain[k + 1]);
        transforms[k] = transform.inverse().after(&transforms[k + 1]);
        // I_k = g I_{k+1} + o, solved for I_{k+1}.
        let factor = |place| {
            let next = transform.apply(place, middle);
            outer.factor(next) / inner.factor(next)
        };
        let (a, b) = (outer.photometric, inner.photometric);
        chain[k] = shaded(size, a.gain / b.gain, a.offset - a.gain * b.offset / b.gain, factor);
    }
    (transforms, chain)
}

/// Gain, offset and what the gain is multiplied by at each place, px. That an offset which is shaded again varies with the
/// place is left out: it is the product of two small numbers.
fn shaded(size: [u32; 2], gain: f64, offset: f64, factor: impl Fn([f64; 2]) -> f64) -> Brightness {
    let half = centre(size[0], size[1]);
    let (mean, shading) = Shading::fit(|place| factor([0, 1].map(|i| half[i] * (1.0 + place[i]))));
    Brightness { photometric: Photometric { gain: mean * gain, offset }, shading, ..Brightness::unchanged(size) }
}

/// A pair on the reference's pixels, in their px². What is at the limit of |V| is only a bound, and says nothing.
fn observation(solution: &Solution, t: &Homography, positions: [f64; 2], limit: f32) -> Observation {
    let size = [solution.width as usize, solution.height as usize];
    let below = |v: &f32| if v.abs() < 0.999 * limit { *v } else { f32::NAN };
    let relative_blur: Vec<f32> = solution.relative_blur.iter().map(below).collect();
    let on_reference = |values: &[f32]| {
        let image = Interleaved { width: size[0], height: size[1], channels: 1, values };
        onto(&image, t, size, Interpolation::Linear)
    };
    let area = t.scale().powi(2) as f32;
    let moved = on_reference(&relative_blur).into_iter().zip(on_reference(&solution.uncertainty));
    Observation { positions, measured: moved.map(|(v, deviation)| [v / area, deviation / area]).collect() }
}

fn warnings(solutions: &[Solution]) -> Vec<String> {
    let of = |(n, solution): (usize, &Solution)| {
        let name = format!("frames {} and {}", n + 1, n + 2);
        solution.warnings.iter().map(move |warning| format!("{name}: {warning}")).collect::<Vec<_>>()
    };
    solutions.iter().enumerate().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;

    #[test]
    fn transforms_and_exposures_are_chained_both_ways() {
        let (a, b) = (Similarity::new(1.0, 2.0, 0.3, 1.01), Similarity::new(-0.5, 1.0, -0.2, 0.98));
        let (a, b) = (Homography::from(a), Homography::from(b));
        let mut ramp = Shading::NONE;
        ramp.coefficients[0] = 0.1;
        let of = |gain, offset, shading| {
            let photometric = Photometric { gain, offset };
            Brightness { photometric, shading, ..Brightness::unchanged([100, 80]) }
        };
        let steps = [(a, of(1.1, 0.02, Shading::NONE)), (b, of(0.9, -0.01, ramp))];
        let (transforms, chain) = chained(&steps, 1);
        let near = |t: &Homography, e: &Homography| assert!(t.corner_distance(e, 100, 80) < 1e-9);
        near(&transforms[0], &a.inverse());
        near(&transforms[1], &Homography::IDENTITY);
        near(&transforms[2], &b);
        // I0 = 1.1 I1 + 0.02, so I1's value 0.5 stands as 0.57 in I0 and comes back.
        assert!((chain[0].of(0.57, [20.0, 30.0]) - 0.5).abs() < 1e-12);
        assert!((chain[2].of(0.5, [99.0, 0.0]) - (0.9 * 1.1 * 0.5 - 0.01)).abs() < 1e-12);
        // From the first frame the ramp, 0.9 to 1.1 on the last, is followed by way of the second.
        let whole = chained(&steps, 0).1[2];
        assert!((whole.factor([99.0, 40.0]) / whole.factor([0.0, 40.0]) - 1.1 / 0.9).abs() < 1e-9);
        // And backwards it is divided by: at the same place of the second frame, within what a polynomial gives of 1/x.
        let last = chained(&steps, 2).1;
        let [x, y] = b.apply([10.0, 60.0], centre(100, 80));
        let expected = 1.0 / (0.9 * ramp.at([x / 49.5 - 1.0, y / 39.5 - 1.0]));
        let found = last[1].photometric.gain * last[1].factor([10.0, 60.0]);
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        near(&chained(&steps, 0).0[2], &b.after(&a));
    }
}
