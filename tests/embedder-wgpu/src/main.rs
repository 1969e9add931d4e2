//! A program on wgpu that shares its device with the engine and draws V on the device.
//!
//!     cargo run --package embedder-wgpu [PICTURE.ppm]
//!
//! `shared.rs` opens the device, `canvas.rs` draws. `messages.rs` does not use the engine.

mod canvas;
mod messages;
mod shared;

use std::error::Error;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use embedder::{RANGE, SIZE, compare, pair, validate, write_ppm};
use parfocal::interop::SharedQueue;
use parfocal::{Engine, EngineOptions, PairSolver, Settings, SolveOptions};

use crate::canvas::Canvas;

fn main() -> Result<(), Box<dyn Error>> {
    messages::listen();
    let picture = draw()?;
    assert!(messages::heard().is_empty(), "validation: {:#?}", messages::heard());
    if let Some(path) = std::env::args().nth(1) {
        write_ppm(&path, &picture)?;
    }
    Ok(())
}

fn adapter() -> Result<wgpu::Adapter, Box<dyn Error>> {
    let flags = wgpu::InstanceFlags::VALIDATION | wgpu::InstanceFlags::DEBUG;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::VULKAN,
        flags: if validate() { flags } else { wgpu::InstanceFlags::empty() },
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    Ok(pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?)
}

fn draw() -> Result<Vec<u8>, Box<dyn Error>> {
    let adapter = adapter()?;
    let turns = Arc::<SharedQueue>::default();
    // SAFETY: all below takes turns at the queue; what is declared later goes earlier, the engine before the device.
    let (device, queue, foreign) = unsafe { shared::open(&adapter, &turns) }?;
    let engine = Engine::from_vulkan(foreign, &EngineOptions::default())?;
    let [i1, i2] = pair(|x| x + 0.25);
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default())?;
    let canvas = Canvas::new(&device, &queue, &turns, [SIZE; 2], RANGE);
    let mut picture = Vec::new();
    beside(&device, &queue, &turns, || {
        for _frame in 0..2 {
            let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default())?;
            // SAFETY: it is read before the pair is dropped.
            unsafe { canvas.draw(&pending.on_device()) }?;
            picture = canvas.read()?;
            let solution = pending.wait()?;
            compare(&picture, solution.relative_blur());
        }
        Ok::<_, Box<dyn Error>>(())
    })?;
    println!("{}: V drawn by wgpu where the engine left it", engine.info().name);
    Ok(picture)
}

/// Runs a function while another thread submits to wgpu's queue, as drawing programs do.
fn beside<T>(device: &wgpu::Device, queue: &wgpu::Queue, turns: &SharedQueue, of: impl FnOnce() -> T) -> T {
    let (usage, size) = (wgpu::BufferUsages::COPY_DST, 256);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
    let (end, ended) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let _end = end; // dropped with this function, also if `of` panics
        scope.spawn(move || {
            while ended.recv_timeout(Duration::from_millis(1)) == Err(mpsc::RecvTimeoutError::Timeout) {
                let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                encoder.clear_buffer(&buffer, 0, None);
                let _turn = turns.acquire();
                queue.submit([encoder.finish()]);
            }
        });
        of()
    })
}

#[cfg(test)]
mod tests {
    use parfocal::interop::DeviceSolution;
    use parfocal::interop::ash::vk;
    use wgpu::hal::api::Vulkan;

    use super::*;

    /// A device with one queue would draw V in order without the semaphore. Here the host signals it.
    #[test]
    fn nothing_is_drawn_before_the_semaphore_is_signalled() {
        let turns = Arc::<SharedQueue>::default();
        // SAFETY: nothing else uses the queue but by turns; the engine and the solver go before the device.
        let (device, queue, foreign) = unsafe { shared::open(&adapter().unwrap(), &turns) }.unwrap();
        let engine = Engine::from_vulkan(foreign, &EngineOptions::default()).unwrap();
        let [i1, i2] = pair(|x| x);
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
        pending.wait().unwrap();
        let canvas = Canvas::new(&device, &queue, &turns, [SIZE; 2], RANGE);
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: all is of this device; the semaphore goes when what waits for it is done.
        unsafe {
            let raw = device.as_hal::<Vulkan>().unwrap().raw_device().clone();
            let semaphore = raw.create_semaphore(&create, None).unwrap();
            canvas.draw(&DeviceSolution { semaphore, value: 1, ..pending.on_device() }).unwrap();
            let limit = wgpu::PollType::Wait { submission_index: None, timeout: Some(Duration::from_millis(100)) };
            let early = device.poll(limit);
            raw.signal_semaphore(&vk::SemaphoreSignalInfo::default().semaphore(semaphore).value(1)).unwrap();
            canvas.read().unwrap();
            raw.destroy_semaphore(semaphore, None);
            assert!(matches!(early, Err(wgpu::PollError::Timeout)), "drawn before its time: {early:?}");
        }
    }
}
