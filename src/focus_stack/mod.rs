//! A focus sweep: more than two photographs of one scene, each focused a little further, to one map of where every
//! pixel is in focus and one image sharp all over.
//!
//! Each frame and the next are solved as a pair ([`Solver`]), which registers them too. Their relative blurs are combined
//! on the pixels of one frame, the reference (`combine.rs` has the model): a point that is blurred too widely in one pair
//! is decided by the pairs between whose frames it comes into focus.

mod combine;
mod fuse;

use self::combine::Observation;
use crate::resample::{Grid, Interpolation, onto};
use crate::{Channels, Engine, Error, Frame, Photometric, Settings, Similarity, Solution, Solver};

/// How a sweep is solved.
#[derive(Clone, Debug)]
pub struct SweepOptions {
    /// Settings of each pair.
    pub settings: Settings,
    /// The focus setting of each frame in any unit that is even in 1/z, ascending or descending; `None` counts the frames
    /// from 0.
    pub positions: Option<Vec<f64>>,
    /// The frame on whose pixels the results are; `None` takes the middle one.
    pub reference: Option<usize>,
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
    /// Grey only if all frames are.
    pub fused_channels: Channels,
    /// The all-in-focus image, interleaved, in the values of the reference with white at 1.
    pub fused: Vec<f32>,
    /// The frame on whose pixels the results are.
    pub reference: usize,
    /// The focus setting of each frame.
    pub positions: Vec<f64>,
    /// Where each pixel of the reference lies in each frame.
    pub transforms: Vec<Similarity>,
    /// What maps each frame's exposure to the reference's.
    pub photometric: Vec<Photometric>,
    /// c: by how many px² of variance blur grows with the squared distance from the focus, in settings.
    pub blur_rate: f64,
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
    let positions = checked(frames, options)?;
    let reference = options.reference.unwrap_or(frames.len() / 2);
    let size = [frames[0].width() as usize, frames[0].height() as usize];
    let mut solver = Solver::for_pair(engine, &frames[0], &frames[1], &options.settings)?;
    let mut solutions = Vec::new();
    for (n, pair) in frames.windows(2).enumerate() {
        let mut solution = solver.solve(&pair[0], &pair[1])?;
        // Only V and its deviation are kept of so many.
        (solution.fused, solution.confidence) = (Vec::new(), Vec::new());
        solutions.push(solution);
        say(n + 1, frames.len() - 1);
    }
    let steps: Vec<_> = solutions.iter().map(|solution| (solution.transform, solution.photometric)).collect();
    let (transforms, photometric) = chained(&steps, reference);
    let limit = options.settings.max_relative_blur as f32;
    let pairs: Vec<Observation> = solutions
        .iter()
        .zip(&transforms)
        .zip(positions.windows(2))
        .map(|((solution, t), p)| observation(solution, t, [p[0], p[1]], size, limit))
        .collect();
    let blur_rate = combine::blur_rate(&pairs).ok_or_else(|| {
        Error::Mismatch(
            "the frames do not come into focus one after the other: see that they are in the order of their focus, \
             and that they overlap in depth (each point sharp enough in two frames)"
                .to_string(),
        )
    })?;
    let found = combine::combine(&pairs, blur_rate, size[0]);
    let (focus, uncertainty): (Vec<f32>, Vec<f32>) = found.iter().map(|&[u, s]| (u, s)).unzip();
    let placed = fuse::Placed { transforms: &transforms, photometric: &photometric, positions: &positions };
    let (fused, fused_channels) = fuse::fuse(frames, &placed, reference, &focus, options.settings.decode);
    Ok(Sweep {
        width: frames[0].width(),
        height: frames[0].height(),
        focus,
        uncertainty,
        fused_channels,
        fused,
        reference,
        positions,
        transforms,
        photometric,
        blur_rate,
        warnings: warnings(&solutions),
    })
}

/// The focus settings, once frames and options fit each other.
fn checked(frames: &[Frame], options: &SweepOptions) -> Result<Vec<f64>, Error> {
    let mismatch = |problem: String| Err(Error::Mismatch(problem));
    if frames.len() < 3 {
        return mismatch(format!(
            "a sweep has three frames or more, not {}; solve a pair with parfocal solve",
            frames.len()
        ));
    }
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
    if options.reference.is_some_and(|reference| reference >= frames.len()) {
        return mismatch(format!("there is no such reference frame among {}", frames.len()));
    }
    let positions = options.positions.clone().unwrap_or_else(|| (0..frames.len()).map(|n| n as f64).collect());
    let rises = |a: f64, b: f64| a < b;
    let falls = |a: f64, b: f64| a > b;
    let ordered = |by: fn(f64, f64) -> bool| positions.windows(2).all(|p| by(p[0], p[1]));
    if positions.len() != frames.len()
        || !positions.iter().all(|p| p.is_finite())
        || !(ordered(rises) || ordered(falls))
    {
        return mismatch(format!(
            "{} positions for {} frames: give one for each, ascending or descending",
            positions.len(),
            frames.len()
        ));
    }
    Ok(positions)
}

/// From the reference to each frame, by way of those between; exposures the other way.
fn chained(steps: &[(Similarity, Photometric)], reference: usize) -> (Vec<Similarity>, Vec<Photometric>) {
    let frames = steps.len() + 1;
    let (mut transforms, mut exposures) = (vec![Similarity::IDENTITY; frames], vec![Photometric::IDENTITY; frames]);
    for k in reference..steps.len() {
        let (transform, inner) = steps[k];
        transforms[k + 1] = transform.after(&transforms[k]);
        let outer = exposures[k];
        exposures[k + 1] =
            Photometric { gain: outer.gain * inner.gain, offset: outer.gain * inner.offset + outer.offset };
    }
    for k in (0..reference).rev() {
        let (transform, Photometric { gain, offset }) = steps[k];
        transforms[k] = transform.inverse().after(&transforms[k + 1]);
        // I_k = g I_{k+1} + o, solved for I_{k+1}.
        let outer = exposures[k + 1];
        exposures[k] = Photometric { gain: outer.gain / gain, offset: outer.offset - outer.gain * offset / gain };
    }
    (transforms, exposures)
}

/// A pair on the reference's pixels, in their px². What is at the limit of |V| is only a bound, and says nothing.
fn observation(solution: &Solution, t: &Similarity, positions: [f64; 2], size: [usize; 2], limit: f32) -> Observation {
    let below = |v: &f32| if v.abs() < 0.999 * limit { *v } else { f32::NAN };
    let relative_blur: Vec<f32> = solution.relative_blur.iter().map(below).collect();
    let on_reference = |values: &[f32]| {
        let grid = Grid { width: size[0], height: size[1], channels: 1, values };
        let mut moved = onto(&grid, t, size, Interpolation::Linear);
        let area = (t.scale * t.scale) as f32;
        moved.iter_mut().for_each(|v| *v /= area);
        moved
    };
    Observation {
        positions,
        relative_blur: on_reference(&relative_blur),
        uncertainty: on_reference(&solution.uncertainty),
    }
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

    #[test]
    fn transforms_and_exposures_are_chained_both_ways() {
        let (a, b) = (Similarity::new(1.0, 2.0, 0.3, 1.01), Similarity::new(-0.5, 1.0, -0.2, 0.98));
        let steps = [(a, Photometric { gain: 1.1, offset: 0.02 }), (b, Photometric { gain: 0.9, offset: -0.01 })];
        let (transforms, exposures) = chained(&steps, 1);
        let near = |t: &Similarity, e: &Similarity| assert!(t.corner_distance(e, 100, 80) < 1e-9);
        near(&transforms[0], &a.inverse());
        near(&transforms[1], &Similarity::IDENTITY);
        near(&transforms[2], &b);
        // I0 = 1.1 I1 + 0.02, so I1's value 0.5 stands as 0.57 in I0 and comes back.
        assert!((exposures[0].gain * 0.57 + exposures[0].offset - 0.5).abs() < 1e-12);
        assert!((exposures[2].gain - 0.9).abs() < 1e-12 && (exposures[2].offset + 0.01).abs() < 1e-12);
        near(&chained(&steps, 0).0[2], &b.after(&a));
    }
}
