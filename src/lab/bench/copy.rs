//! What the memory does at most: a pass that copies an image of floats, in the kind of memory that all passes use.

use std::sync::Arc;

use super::Spread;
use crate::base::Error;
use crate::engine::Engine;
use crate::engine::stages::NO_VARIANT;
use crate::engine::stages::copy::{self, Constants};
use crate::engine::stages::pass::Pass;
use crate::engine::vulkan::{Clock, Image, Pipeline, Recorder, Resource, Texel, Workgroups};

/// Width and height, pixels: as wide as every Vulkan device takes, and 64 MiB an image, more than most caches hold of two.
const SIZE: [u32; 2] = [4096, 4096];
/// Copies that are timed.
const COPIES: u32 = 8;

/// Bytes read and written in a second, 10⁹; nothing where the device has no clock.
pub(super) fn bandwidth(engine: &Engine) -> Result<Option<Spread>, Error> {
    let device = engine.device();
    let pipeline = Arc::new(Pipeline::new(device, &copy::STAGE)?);
    let [width, height] = SIZE;
    let (from, to) = (image(engine, "copied from")?, image(engine, "copied to")?);
    let constants = Constants { width, height, layer: 0 };
    let copy = |recorder: &mut Recorder| {
        let resources = [Resource::Image(&from), Resource::Image(&to)];
        recorder.barrier();
        let groups = Workgroups::Direct(copy::STAGE.groups(SIZE));
        recorder.dispatch(&pipeline, &resources, bytemuck::bytes_of(&constants), groups)
    };
    // The first copy brings the pages in.
    let mut first = Recorder::new(device, Clock::Never)?;
    first.initialize(&[&from, &to]);
    first.clear_image(&from);
    copy(&mut first)?;
    first.finish()?.run()?;
    let mut recorder = Recorder::new(device, Clock::Dispatches(COPIES))?;
    for _ in 0..COPIES {
        copy(&mut recorder)?;
    }
    let mut recording = recorder.finish()?;
    recording.run()?;
    let ends = recording.times()?.ends_ms;
    let starts = std::iter::once(0.0).chain(ends.iter().copied());
    let rate = |ms: f64| copy::Bindings::bytes(&constants, NO_VARIANT) as f64 / ms * 1e-6;
    let rates: Vec<f64> = starts.zip(&ends).map(|(start, end)| rate(end - start)).collect();
    Ok(Spread::of(&rates))
}

fn image(engine: &Engine, name: &str) -> Result<Arc<Image>, Error> {
    Image::new(engine.device(), name, SIZE, 1, Texel::One)
}
