//! The whole solver in plain Rust and double precision, built of the [`stages`](crate::stages)' twins: slow, for tests and
//! for learning. It takes the same [`Settings`] and goes through the same passes in the same order.

use crate::base::color::LUMINANCE;
use crate::base::{Error, Frame, Kernel, Mask, Method, Photometric, Settings, Similarity};
use crate::engine::filter;
use crate::engine::plan::{Level, Plan, halving_filter};
use crate::engine::same_size;
use crate::engine::stages::mask::{self, Masks};
use crate::engine::stages::stack::{Grid, Layer, Slopes, layer};
use crate::engine::stages::state::Registration;
use crate::engine::stages::{
    Field, appearance, blur, confidence, convolve, evidence, expose, fuse, ingest, linearise, prolong, refine,
    relax_level, residual, step, update, warp,
};

/// What the reference finds.
pub struct Reference {
    /// V where it is valid, NaN elsewhere, px².
    pub relative_blur: Field,
    /// Standard deviation of V, px², NaN where V is.
    pub uncertainty: Field,
    /// Root mean square residual, intensities, NaN where V is.
    pub residual: Field,
    /// Pseudo-radiance, luminance only.
    pub fused: Field,
    /// T.
    pub transform: Similarity,
    /// Gain and offset.
    pub photometric: Photometric,
    /// Energy by level, coarse to fine, and outer iteration.
    pub energies: Vec<Vec<f64>>,
}

/// Solves one pair on the CPU.
///
/// # Errors
/// [`Error::Setting`], [`Error::TooSmall`], [`Error::Mismatch`] where the sizes differ, [`Error::NoKeyPoints`] for SIFT.
pub fn solve(i1: &Frame, i2: &Frame, settings: &Settings) -> Result<Reference, Error> {
    solve_masked(i1, i2, settings, None)
}

/// Solves one pair on the CPU, without the pixels of I1 that a mask leaves out.
///
/// # Errors
/// As [`solve`].
pub fn solve_masked(i1: &Frame, i2: &Frame, settings: &Settings, mask: Option<&Mask>) -> Result<Reference, Error> {
    same_size([i1, i2])?;
    let plan = Plan::new(i1.width(), i1.height(), [i1.format(), i2.format()], settings)?;
    let pyramids = [i1, i2].map(|frame| pyramid(&plan, ingest::twin(frame, settings.decode, LUMINANCE)));
    let masks = masks(&plan, [i1, i2], mask);
    if settings.method == Method::Sift {
        return Err(Error::NoKeyPoints);
    }
    let mut registration = Registration::new(&settings.start, &settings.start_photometric);
    for level in plan.appearance_levels() {
        register(&plan, level, &pyramids, &masks, &mut registration);
    }
    let mut v: Option<Field> = None;
    let (mut system, mut squared) = (None, None);
    let mut energies = Vec::new();
    for level in plan.coarse_to_fine() {
        let mut blur = start(level, v.take());
        if plan.matches_exposure() {
            match_exposure(&plan, level, &pyramids, &masks, &blur, &mut registration);
        }
        let images = pyramids.each_ref().map(|p| &p[level.index]);
        let mut stacks = images.map(|image| build_stack(image, &settings.kernel, level.nodes));
        let mut warped = None;
        if plan.warps(level) {
            warped = Some(registration);
            stacks[1] = warped_stack(level, &registration, images[1]);
        }
        let mut energy = Vec::new();
        for k in 0..settings.outer_iterations {
            if plan.warps_anew(level, k)
                && let Some(before) = &mut warped
                && step::moved_away(&plan.step(level, k), before, &registration)
            {
                *before = registration;
                stacks[1] = warped_stack(level, &registration, images[1]);
            }
            let constants = plan.linearise(level, k);
            let read = blur::Stacks { first: &stacks[0], second: &stacks[1], slopes: plan.slopes() };
            let masks = Some(&masks[level.index]);
            let linear = linearise::twin(&constants, &registration, warped.as_ref(), images[0], &blur, &read, masks);
            let before = energy.last().copied().unwrap_or(0.0);
            let step = step::twin(&plan.step(level, k), &linear.sums, &mut registration, before);
            energy.push(step.energy);
            if !step.settled {
                let change = relaxed(&plan, level, &linear.system);
                update::twin(&update_constants(&plan, level), &change, &mut blur);
            }
            system = Some(linear.system);
            if step.settled {
                break;
            }
        }
        energies.push(energy);
        if level.index == 0 {
            let read = blur::Stacks { first: &stacks[0], second: &stacks[1], slopes: plan.slopes() };
            squared = Some(residual::twin(&plan.residual(), &registration, warped.as_ref(), images[0], &blur, &read));
        }
        v = Some(blur);
    }
    let (Some(v), Some(system), Some(squared)) = (v, system, squared) else {
        return Err(Error::Setting { name: "levels", value: 0.0, range: "at least 1".into() });
    };
    let finest = &plan.pyramid[0];
    let centre = finest.centre.map(|c| c as f32);
    let [width, height] = finest.size;
    let [d, b2, g2] = evidence::twin(&plan.evidence(), &v, &system);
    let evidence = [d, b2, g2, squared].map(|field| separable(&field, &evidence::window(), 1));
    let found = confidence::twin(&plan.confidence(), &registration, &v, &evidence);
    let coefficients = build_stack(&pyramids[1][0], &Kernel::Gaussian, 1);
    let epsilon = settings.heaviside_epsilon as f32;
    let fuse = fuse::Constants { width, height, layer: 0, centre, epsilon };
    let fused = fuse::twin(&fuse, &registration, &pyramids[0][0], &coefficients[0], &v);
    let [relative_blur, uncertainty, residual] = found;
    Ok(Reference {
        relative_blur,
        uncertainty,
        residual,
        fused,
        transform: registration.transform(),
        photometric: registration.photometric(),
        energies,
    })
}

fn match_exposure(
    plan: &Plan,
    level: &Level,
    pyramids: &[Vec<Field>; 2],
    masks: &[Masks],
    blur: &Field,
    registration: &mut Registration,
) {
    let (low_pass, constants) = plan.expose(level, true);
    let [i1, i2] = pyramids.each_ref().map(|p| &p[low_pass]);
    expose::twin(&constants, registration, i1, i2, blur, Some(&masks[low_pass]));
}

/// Registers without a blur model on one level.
fn register(plan: &Plan, level: &Level, pyramids: &[Vec<Field>; 2], masks: &[Masks], registration: &mut Registration) {
    if plan.matches_exposure() {
        // Nothing is known of V yet.
        match_exposure(plan, level, pyramids, masks, &Field::zeros(1, 1), registration);
    }
    let [i1, i2] = pyramids.each_ref().map(|p| &p[level.index]);
    let spline = build_stack(i2, &Kernel::Gaussian, 1);
    let mut before = 0.0;
    for k in 0..plan.settings.outer_iterations {
        let sums = appearance::twin(&plan.appearance(level), registration, i1, &spline[0], Some(&masks[level.index]));
        let step = step::twin(&plan.appearance_step(level, k), &sums, registration, before);
        if step.settled {
            break;
        }
        before = step.energy;
    }
}

/// The stack of I2 on I1's pixels.
fn warped_stack(level: &Level, registration: &Registration, i2: &Field) -> Vec<Field> {
    let [width, height] = level.size;
    let (factor, centre) = (level.factor as f32, level.centre.map(|c| c as f32));
    let constants = warp::Constants { width, height, layer: 0, factor, centre };
    let spline = build_stack(i2, &Kernel::Gaussian, 1);
    build_stack(&warp::twin(&constants, registration, &spline[0]), &Kernel::Gaussian, level.nodes)
}

/// A filter along x, then along y.
fn separable(image: &Field, filter: &[f64], stride: usize) -> Field {
    convolve::twin(&convolve::twin(image, filter, stride, false), filter, stride, true)
}

fn pyramid(plan: &Plan, finest: Field) -> Vec<Field> {
    let mut levels = vec![finest];
    for level in 1..plan.pyramid.len() {
        levels.push(separable(&levels[level - 1], &halving_filter(), 2));
    }
    levels
}

/// Which pixels count, by level.
fn masks(plan: &Plan, frames: [&Frame; 2], mask: Option<&Mask>) -> Vec<Masks> {
    let [first, second] = [0, 1].map(|image| {
        let frame: &Frame = frames[image];
        let clipped = plan.settings.clipped(frame.format().depth);
        let mask = mask::twin(frame, clipped, mask.filter(|_| image == 0).map(Mask::bytes));
        pyramid(plan, separable(&mask, &evidence::window(), 1))
    });
    first.into_iter().zip(second).map(|(first, second)| [first, second]).collect()
}

/// Spline coefficients of an image, then of the other layers of its [`stack`](crate::stages::stack).
pub fn build_stack(image: &Field, kernel: &Kernel, nodes: usize) -> Vec<Field> {
    let mut stack = vec![separable(image, &filter::spline_prefilter(), 1)];
    // The last of the layers made on every other pixel, as it was there.
    let mut half: Option<Field> = None;
    for n in 1..nodes * Slopes::of(kernel).layers() {
        let Layer { from, grid, terms } = layer(kernel, n);
        if grid != Grid::Every {
            let made = on_half(half.as_ref().unwrap_or(&stack[from]), &terms[0], grid, image);
            stack.push(refine::twin([image.width, image.height], &made));
            half = Some(made);
            continue;
        }
        let mut sum = Field::zeros(image.width, image.height);
        for [along_x, along_y] in &terms {
            let term = convolve::twin(&convolve::twin(&stack[from], along_x, 1, false), along_y, 1, true);
            sum.data.iter_mut().zip(term.data).for_each(|(sum, t)| *sum += t);
        }
        stack.push(sum);
    }
    stack
}

/// A layer on every other pixel of the image.
fn on_half(from: &Field, [along_x, along_y]: &[filter::Filter; 2], grid: Grid, image: &Field) -> Field {
    if grid == Grid::Halving {
        return convolve::twin(&convolve::twin(from, along_x, 2, false), along_y, 2, true);
    }
    let rows = convolve::twin_mirrored(from, along_x, 1, false, image.width - 1);
    convolve::twin_mirrored(&rows, along_y, 1, true, image.height - 1)
}

fn start(level: &Level, coarser: Option<Field>) -> Field {
    let [width, height] = level.size;
    match coarser {
        None => Field::zeros(width as usize, height as usize),
        Some(coarser) => prolong::twin(&prolong::Constants { width, height, limit: level.limit as f32 }, &coarser),
    }
}

fn relaxed(plan: &Plan, level: &Level, system: &[Field; 5]) -> Field {
    let [width, height] = level.size;
    let (sweeps, over_relaxation) = (plan.settings.sweeps, plan.settings.over_relaxation as f32);
    relax_level::twin(&relax_level::Constants { width, height, sweeps, over_relaxation }, system)
}

fn update_constants(plan: &Plan, level: &Level) -> update::Constants {
    let [width, height] = level.size;
    let largest_step = plan.settings.largest_step as f32;
    update::Constants { width, height, largest_step, limit: level.limit as f32 }
}
