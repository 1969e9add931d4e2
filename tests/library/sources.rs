//! Tests of image sources: packed camera formats, memory of the caller, memory shared with the device.
#![allow(unsafe_code, reason = "the constructors of shared memory are unsafe")]

use std::ptr::NonNull;
use std::time::{Duration, Instant};

#[cfg(target_os = "linux")]
use parfocal::interop::DmaBuf;
use parfocal::{
    Engine, EngineOptions, Error, Frame, PairSolver, Pending, PixelFormat, Settings, SolveOptions,
    frame::{Depth, Samples, Source},
    interop::HostMemory,
    settings::Decode,
    transform::Similarity,
};

use crate::common::scene::pair;
use crate::common::{TestEngine, options};

/// An image size whose rows are whole bytes in every format.
const SIZE: [u32; 2] = [96, 80];

fn frames() -> [Frame; 2] {
    pair(SIZE, Similarity::new(0.4, -0.3, 0.05, 1.0), |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, 3)
}

/// Packs a grey frame into the bytes that a camera sends in this format.
fn packed(frame: &Frame, format: PixelFormat) -> Vec<u8> {
    let Samples::F32(values) = frame.samples() else { unreachable!() };
    let name = format.to_string();
    let bits = if name.contains("10") {
        10
    } else if name.contains("12") {
        12
    } else if name.contains("16") {
        16
    } else {
        8
    };
    let value = |v: &f32| (f64::from(*v) * f64::from((1u32 << bits) - 1)).round() as u16;
    let samples = values.iter().map(value);
    if name.ends_with('p') {
        // Four samples take five bytes at 10 bits and six bytes at 12 bits.
        let words: Vec<u16> = samples.collect();
        let word = |four: &[u16]| four.iter().rev().fold(0u64, |all, &v| all << bits | u64::from(v));
        return words.chunks(4).flat_map(|four| word(four).to_le_bytes()[..bits / 2].to_vec()).collect();
    }
    if name.ends_with("Packed") {
        let words: Vec<u16> = samples.collect();
        let (low, mask) = (bits - 8, (1u16 << (bits - 8)) - 1);
        let pair = |two: &[u16]| [two[0] >> low, two[0] & mask | (two[1] & mask) << 4, two[1] >> low].map(|b| b as u8);
        return words.chunks(2).flat_map(pair).collect();
    }
    let times = match name.as_str() {
        "RGB8" | "BGR8" => 3,
        "RGBa8" | "BGRa8" => 4,
        _ => 1,
    };
    let bytes = |v: u16| if bits == 8 { vec![v as u8; times] } else { v.to_le_bytes().to_vec() };
    samples.flat_map(bytes).collect()
}

/// Adds gaps between the rows, so that a row starts every `pitch` bytes.
fn with_gaps(bytes: &[u8], pitch: usize) -> Vec<u8> {
    let row = bytes.len() / SIZE[1] as usize;
    bytes.chunks(row).flat_map(|row| [row, &vec![0xa5; pitch - row.len()]].concat()).collect()
}

fn formats() -> impl Iterator<Item = PixelFormat> {
    ["Mono8", "Mono12", "Mono10p", "Mono12p", "Mono12Packed", "BGR8", "BGRa8", "BayerGB8", "BayerRG12p"]
        .into_iter()
        .map(|name| name.parse().unwrap())
}

fn submit(solver: &mut PairSolver, sources: [Source<'_>; 2]) -> Pending {
    solver.submit(sources, &[], &SolveOptions::default()).unwrap()
}

fn bits(mut pending: Pending) -> Vec<u32> {
    let view = pending.wait().unwrap();
    assert!(view.converged, "{:?}", view.warnings);
    let fused = (0..view.fused_channels.count() as usize).filter_map(|n| view.fused(n)).flatten();
    view.relative_blur().iter().chain(view.uncertainty()).chain(fused).map(|v| v.to_bits()).collect()
}

#[test]
fn every_source_gives_the_results_of_unpacked_frames() {
    let (engine, frames) = (TestEngine::new(), frames());
    for format in formats() {
        // Some pixels are clipped, so that frames use the same passes as all other sources.
        let white = if format.format().depth == Depth::U8 { 255.0 } else { 65535.0 };
        let settings = Settings { white_level: Some(0.75 * white), decode: Decode::None, ..Settings::default() };
        let photographs = frames.each_ref().map(|frame| packed(frame, format));
        let [i1, i2] = photographs.each_ref().map(|bytes| format.frame(SIZE, bytes).unwrap());
        let expected = engine.solve([&i1, &i2], &settings);
        let mut solver = PairSolver::for_size(&engine, SIZE, [format; 2], 2, &settings).unwrap();
        let pitch = photographs[0].len() / SIZE[1] as usize + 7;
        let [a, b] = photographs.each_ref().map(|bytes| with_gaps(bytes, pitch));
        let write = |bytes: &mut [u8]| bytes.copy_from_slice(&photographs[0]);
        // SAFETY: the bytes outlive the pairs of the solver and are not written.
        let [near, far] =
            [&photographs[0], &b].map(|of| unsafe { HostMemory::new(NonNull::from(of.as_slice()).cast(), of.len()) });
        let (near, far) = (engine.share(near), engine.share(far));
        let rows = |bytes, pitch| Source::Rows { bytes, pitch };
        let copied = [[rows(&a, pitch), rows(&photographs[1], 0)], [Source::Write(&write), rows(&b, pitch)]];
        let in_flight = copied.map(|sources| submit(&mut solver, sources));
        let mut found = in_flight.map(bits).to_vec();
        let shared = [(&near, 0), (&far, pitch)].map(|(memory, pitch)| Source::Shared { memory, offset: 0, pitch });
        let mut pending = submit(&mut solver, shared);
        assert_eq!(pending.is_fetched(), [!near.is_staged(), !far.is_staged()]);
        assert!(pending.wait_fetched(Duration::MAX).unwrap());
        found.push(bits(pending));
        let fused = expected.fused.chunks(expected.fused_channels.count() as usize);
        let planes: Vec<f32> = (0..expected.fused_channels.count() as usize)
            .flat_map(|n| fused.clone().map(move |pixel| pixel[n]))
            .collect();
        let all = expected.relative_blur.iter().chain(&expected.uncertainty).chain(&planes);
        let expected: Vec<u32> = all.map(|v| v.to_bits()).collect();
        assert!(found.iter().all(|found| *found == expected), "{format}");
    }
}

#[test]
fn shared_memory_can_be_overwritten_after_the_device_has_read_it() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let format = PixelFormat::from(i1.format());
    let mut ring = [i1.bytes().to_vec(), i2.bytes().to_vec()].concat();
    // The offset is odd and not aligned to a page.
    ring.insert(0, 0);
    // SAFETY: the ring outlives the shared memory. It is written only after the device has read the pair.
    let memory = engine.share(unsafe { HostMemory::new(NonNull::from(ring.as_mut_slice()).cast(), ring.len()) });
    assert_eq!(memory.bytes(), ring.len());
    let mut solver = PairSolver::for_size(&engine, SIZE, [format; 2], 1, &Settings::default()).unwrap();
    let places = [1, 1 + i1.bytes().len()];
    let sources = places.map(|offset| Source::Shared { memory: &memory, offset, pitch: 0 });
    let mut solve = |ring: &mut Vec<u8>| {
        let mut pending = submit(&mut solver, sources);
        assert!(pending.wait_fetched(Duration::MAX).unwrap());
        // The device has its own copy.
        ring.fill(0);
        bits(pending)
    };
    let first = solve(&mut ring);
    for (place, frame) in places.into_iter().zip([&i1, &i2]) {
        ring[place..place + frame.bytes().len()].copy_from_slice(frame.bytes());
    }
    assert_eq!(solve(&mut ring), first);
}

/// Uses a file in memory in place of a dma-buf. No device can import it.
#[cfg(target_os = "linux")]
#[test]
fn the_host_copies_from_memory_that_the_device_cannot_import() {
    use std::io::Write;

    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let mut file = tempfile::tempfile_in("/dev/shm").unwrap();
    file.write_all(&[i1.bytes(), i2.bytes()].concat()).unwrap();
    let bytes = 2 * i1.bytes().len();
    // SAFETY: the file is not changed.
    let short = unsafe { DmaBuf::new(file.try_clone().unwrap().into(), bytes + 1) };
    assert!(engine.share_dma_buf(short).unwrap_err().to_string().contains(&format!("has {bytes} bytes, not")));
    // SAFETY: the file is not changed.
    let memory = engine.share_dma_buf(unsafe { DmaBuf::new(file.into(), bytes) }).unwrap();
    assert!(memory.is_staged());
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let sources = [0, bytes / 2].map(|offset| Source::Shared { memory: &memory, offset, pitch: 0 });
    let pending = submit(&mut solver, sources);
    assert_eq!(pending.is_fetched(), [false; 2]);
    let found = bits(pending);
    let rows = [&i1, &i2].map(|frame| Source::Rows { bytes: frame.bytes(), pitch: 0 });
    assert_eq!(bits(submit(&mut solver, rows)), found);
}

#[test]
fn sources_that_do_not_fit_are_refused() {
    let (engine, [i1, i2]) = (TestEngine::new(), frames());
    let settings = Settings::default();
    let problem = |solver: &mut PairSolver, sources: [Source<'_>; 2]| match solver
        .submit(sources, &[], &SolveOptions::default())
        .map(drop)
    {
        Err(Error::Mismatch(problem)) => problem,
        other => panic!("{other:?}"),
    };
    let mut gray = PairSolver::for_frames(&engine, [&i1, &i2], &settings).unwrap();
    let (frame, mut bytes) = (Source::Frame(&i1), i2.bytes().to_vec());
    let short = Source::Rows { bytes: &bytes[1..], pitch: 0 };
    assert!(problem(&mut gray, [frame, short]).contains("take 30720 bytes, and there are 30719"));
    let narrow = Source::Rows { bytes: &bytes, pitch: 383 };
    assert!(problem(&mut gray, [narrow, frame]).contains("the pitch is 383"));
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&f32::NAN.to_ne_bytes());
    let infinite = Source::Rows { bytes: &bytes, pitch: 0 };
    assert!(problem(&mut gray, [frame, infinite]).contains("photograph 2: a sample is not finite"));
    let format: PixelFormat = "Mono12p".parse().unwrap();
    let mut odd = PairSolver::for_size(&engine, [97, 80], [format; 2], 1, &settings).unwrap();
    let rows = Source::Rows { bytes: &[0; 12000], pitch: 148 };
    assert!(problem(&mut odd, [rows, rows]).contains("ends within a byte"));
    assert!(problem(&mut odd, [frame, rows]).contains("prepared for 97x80 Mono12p, not 96x80"));
    let other = TestEngine::alone();
    // SAFETY: the bytes outlive the shared memory and are not written.
    let memory = other.share(unsafe { HostMemory::new(NonNull::from(bytes.as_slice()).cast(), bytes.len()) });
    let shared = |offset| Source::Shared { memory: &memory, offset, pitch: 0 };
    assert!(problem(&mut gray, [frame, shared(0)]).contains("shared with another engine"));
    let mut its_own = PairSolver::for_frames(&other, [&i1, &i2], &settings).unwrap();
    assert!(problem(&mut its_own, [frame, shared(4)]).contains("there are 30716"));
    assert!(problem(&mut its_own, [frame, shared(usize::MAX)]).contains("there are 0"));
}

/// Measures the time until `submit` returns and until the pair is solved:
/// `cargo test --test library how_long_frames_of_a_camera_take -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn how_long_frames_of_a_camera_take() {
    let engine = Engine::new(&EngineOptions { validation: false, timed: false, ..options() }).unwrap();
    let size = [2448, 2048];
    for name in ["Mono12p", "BayerRG8"] {
        let format: PixelFormat = name.parse().unwrap();
        let bytes: Vec<u8> = (0..format.bytes(size)).map(|i| (i * i / 7 + i / 97) as u8).collect();
        let settings = Settings { levels: Some(1), outer_iterations: 5, fused: false, ..Settings::default() };
        let [plain, unpacked] = [PixelFormat::from(format.format()), format];
        let mut by_host = PairSolver::for_size(&engine, size, [plain; 2], 1, &settings).unwrap();
        let mut by_device = PairSolver::for_size(&engine, size, [unpacked; 2], 1, &settings).unwrap();
        // SAFETY: the bytes outlive the shared memory and are not written.
        let memory = engine.share(unsafe { HostMemory::new(NonNull::from(bytes.as_slice()).cast(), bytes.len()) });
        let mut rounds = [(); 3].map(|()| Vec::new());
        for _ in 0..6 {
            let mut note = |n: usize, solver: &mut PairSolver, submit: &dyn Fn(&mut PairSolver) -> Pending| {
                let began = Instant::now();
                let mut pending = submit(solver);
                let held = began.elapsed();
                pending.wait().unwrap();
                rounds[n].push((held.as_secs_f64() * 1e3, began.elapsed().as_secs_f64() * 1e3));
            };
            note(0, &mut by_host, &|solver| {
                let frame = format.frame(size, &bytes).unwrap();
                submit(solver, [&frame; 2].map(Source::Frame))
            });
            let rows = Source::Rows { bytes: &bytes, pitch: 0 };
            note(1, &mut by_device, &|solver| submit(solver, [rows; 2]));
            let shared = Source::Shared { memory: &memory, offset: 0, pitch: 0 };
            note(2, &mut by_device, &|solver| submit(solver, [shared; 2]));
        }
        for (way, mut times) in ["unpacked by the host", "rows", "shared"].into_iter().zip(rounds) {
            // The first round compiles pipelines.
            times.remove(0);
            times.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (least, [held, whole], most) = (times[0].0, [times[2].0, times[2].1], times[4].0);
            println!(
                "{name}, {way}: submit returns after {held:.1} ms ({least:.1} to {most:.1}), five iterations end after {whole:.0} ms"
            );
        }
    }
}
