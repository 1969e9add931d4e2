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
    messages::start_collecting();
    let picture = draw()?;
    assert!(messages::collected().is_empty(), "validation: {:#?}", messages::collected());
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
    let shared_queue = Arc::<SharedQueue>::default();
    // SAFETY: all code below locks the queue to use it. Locals drop in reverse order: the engine before the device.
    let (device, queue, external) = unsafe { shared::open(&adapter, &shared_queue) }?;
    let engine = Engine::from_vulkan(external, &EngineOptions::default())?;
    let [i1, i2] = pair(|x| x + 0.25);
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default())?;
    let canvas = Canvas::new(&device, &queue, &shared_queue, [SIZE; 2], RANGE);
    let mut picture = Vec::new();
    with_concurrent_submissions(&device, &queue, &shared_queue, || {
        for _frame in 0..2 {
            let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default())?;
            // SAFETY: the picture is read before the pair is dropped.
            unsafe { canvas.draw(&pending.on_device()?) }?;
            picture = canvas.read()?;
            let solution = pending.wait()?;
            compare(&picture, solution.relative_blur());
        }
        Ok::<_, Box<dyn Error>>(())
    })?;
    println!("{}: wgpu drew V from the results buffer of the engine", engine.info().name);
    Ok(picture)
}

/// Runs a function while another thread submits commands to the queue of wgpu.
fn with_concurrent_submissions<T>(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    shared_queue: &SharedQueue,
    of: impl FnOnce() -> T,
) -> T {
    let (usage, size) = (wgpu::BufferUsages::COPY_DST, 256);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
    let (end, ended) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let _end = end; // the thread ends when this is dropped, also if `of` panics
        scope.spawn(move || {
            while ended.recv_timeout(Duration::from_millis(1)) == Err(mpsc::RecvTimeoutError::Timeout) {
                let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                encoder.clear_buffer(&buffer, 0, None);
                let _guard = shared_queue.acquire();
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

    /// One queue could execute the draw in order even without the semaphore. Therefore the host signals the semaphore.
    #[test]
    fn nothing_is_drawn_before_the_semaphore_is_signalled() {
        let shared_queue = Arc::<SharedQueue>::default();
        // SAFETY: all uses of the queue lock it. The engine and the solver are dropped before the device.
        let (device, queue, external) = unsafe { shared::open(&adapter().unwrap(), &shared_queue) }.unwrap();
        let engine = Engine::from_vulkan(external, &EngineOptions::default()).unwrap();
        let [i1, i2] = pair(|x| x);
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
        pending.wait().unwrap();
        let canvas = Canvas::new(&device, &queue, &shared_queue, [SIZE; 2], RANGE);
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: all handles belong to this device. The semaphore is destroyed after the wait for it has ended.
        unsafe {
            let raw = device.as_hal::<Vulkan>().unwrap().raw_device().clone();
            let semaphore = raw.create_semaphore(&create, None).unwrap();
            canvas.draw(&DeviceSolution { semaphore, value: 1, ..pending.on_device().unwrap() }).unwrap();
            let limit = wgpu::PollType::Wait { submission_index: None, timeout: Some(Duration::from_millis(100)) };
            let early = device.poll(limit);
            raw.signal_semaphore(&vk::SemaphoreSignalInfo::default().semaphore(semaphore).value(1)).unwrap();
            canvas.read().unwrap();
            raw.destroy_semaphore(semaphore, None);
            assert!(
                matches!(early, Err(wgpu::PollError::Timeout)),
                "drawn before the semaphore was signalled: {early:?}"
            );
        }
    }
}
