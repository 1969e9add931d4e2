//! A renderer with ash that shares its device with the engine and draws V on the device.
//!
//!     cargo run --package embedder-ash [PICTURE.ppm]
//!
//! `gpu.rs` creates the instance and the device, `canvas.rs` draws. The other files do not use the engine.

mod canvas;
mod gpu;
mod messages;
mod pipeline;

use std::error::Error;

use embedder::{RANGE, SIZE, compare, pair, validate, write_ppm};
use parfocal::{Engine, EngineOptions, PairSolver, Settings, SolveOptions};

use crate::canvas::Canvas;
use crate::gpu::Gpu;

fn main() -> Result<(), Box<dyn Error>> {
    // Locals drop in reverse order: the canvas before the solver, the engine before the device.
    let gpu = Gpu::new(validate())?;
    // SAFETY: the engine, the solver and the pairs are declared after the device, so they are dropped before it.
    let engine = Engine::from_vulkan(unsafe { gpu.external_device() }, &EngineOptions::default())?;
    let [i1, i2] = pair(|x| x + 0.25);
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default())?;
    let mut canvas = Canvas::new(&gpu, [SIZE; 2])?;
    let mut picture = Vec::new();
    for _frame in 0..2 {
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default())?;
        // SAFETY: each picture is read before the next draw and before the pair is dropped.
        unsafe { canvas.draw(&pending.on_device()?, RANGE) }?;
        picture = canvas.read()?;
        let solution = pending.wait()?;
        compare(&picture, solution.relative_blur());
    }
    if let Some(path) = std::env::args().nth(1) {
        write_ppm(&path, &picture)?;
    }
    println!("{}: drew V from the results buffer of the engine", engine.info().name);
    Ok(())
}
