//! The solves that are replayed: between them their scripts reach all shaders but those of [`super::ELSEWHERE`].

use super::{Device, ReplaySolve, replay_on};
use crate::base::{
    Channels, Decode, Depth, Frame, Kernel, Mask, Method, Motion, Parallax, ParallaxSearch, Photometric,
    RegistrationStep, Samples, Settings, Similarity,
};
use crate::engine::plan::Plan;
use crate::engine::script::{CountedPixels, compose};
use crate::engine::stages::harness::Rig;
use crate::engine::stages::pass::Memory;
use crate::engine::stages::state::{DoubleState, Registration};
use crate::engine::{Engine, EngineOptions, cpu};
use crate::lab::scene::{Preset, Scene, SweepScene};
use crate::solve::SolveOptions;
use crate::solve::sweep::{SweepOptions, SweepSolver};

/// Replays all solves.
fn run_all(replay: ReplaySolve<'_>) {
    for pair in pairs() {
        pair.run(replay);
    }
    let settings = Settings { outer_iterations: 5, ..Settings::default() };
    run_sweep(replay, [103, 77], 5, [0.0; 2], settings.clone());
    run_sweep(replay, [99, 70], 5, [4.0, -3.0], settings.clone());
    let settings = Settings { kernel: Kernel::Pillbox, motion: Motion::Homography, ..settings };
    run_sweep(replay, [67, 53], 4, [0.0; 2], settings);
}

/// A pair of a scene. It has a flat region at the border, clipped pixels, and perhaps a mask that touches a border.
struct Pair {
    size: [u32; 2],
    format: (Channels, Depth),
    is_masked: bool,
    is_flat: bool,
    packs: bool,
    /// What the solve starts from.
    parallax: Parallax,
    preset: Preset,
    settings: Settings,
}

impl Pair {
    fn frame(&self, frame: &Frame) -> Frame {
        let [width, height] = self.size;
        let (channels, depth) = self.format;
        let colors = [0.9, 1.1, 0.8].into_iter().take(channels.count() as usize);
        let values: Vec<f32> = (0..)
            .zip(frame.intensities(Decode::None))
            .flat_map(|(n, v): (u32, f32)| {
                let is_flat = self.is_flat || n % width > width - 14 && n / width > height - 12;
                colors.clone().map(move |c| if is_flat { 0.4 } else { 1.1 * c * v })
            })
            .collect();
        let scaled = |most: f32| values.iter().map(move |v| (v.clamp(0.0, 1.0) * most).round());
        let samples = match depth {
            Depth::U8 => Samples::U8(scaled(255.0).map(|v| v as u8).collect()),
            Depth::U16 => Samples::U16(scaled(65535.0).map(|v| v as u16).collect()),
            Depth::F32 => Samples::F32(values),
        };
        Frame::new(width, height, channels, samples).unwrap()
    }

    fn run(&self, replay: ReplaySolve<'_>) {
        let [width, height] = self.size;
        let scene = Scene { width, height, noise: 0.003, ..self.preset.scene() }.render().unwrap();
        let frames = [scene.i1, scene.i2].map(|frame| self.frame(&frame));
        let formats = frames.each_ref().map(Frame::format);
        let plan = Plan::new(width, height, formats, &self.settings).unwrap();
        let plan = if self.packs { plan } else { plan.for_processor() };
        let mut memory = Memory::<f32>::with_filters(&plan.weights.banks);
        frames.into_iter().enumerate().for_each(|(image, frame)| memory.upload_photograph(image, frame));
        let picture = (0..width * height).map(|n| f32::from(n % width > 6 || n / width > 20)).collect();
        memory.upload_mask(self.is_masked.then(|| Mask::from_image(&Frame::gray(width, height, picture).unwrap())));
        let start = Registration::new(self.settings.start, &Photometric::IDENTITY);
        memory.upload_state(DoubleState { parallax: self.parallax, ..DoubleState::new(start) });
        let counted = if self.is_masked { CountedPixels::Unmasked } else { CountedPixels::All };
        let script = compose(&plan, counted);
        memory.upload_arguments(&script.arguments);
        let second = plan.second_stack(&plan.pyramid[0]) as usize;
        replay(second, &mut || cpu::run(script.entries(), &mut memory, &mut |_| Ok(())).unwrap());
    }
}

fn pairs() -> [Pair; 6] {
    let (gray, rgb) = (Channels::Gray, Channels::Rgb);
    let settings = Settings { outer_iterations: 6, parallax: ParallaxSearch::On, ..Settings::default() };
    let parallax = Parallax { across: [0.05, -0.03], along: 2e-4 };
    let of = |preset, size, format, settings: Settings| Pair {
        size,
        format,
        is_masked: false,
        is_flat: false,
        packs: false,
        parallax: Parallax::NONE,
        preset,
        settings,
    };
    [
        Pair {
            is_masked: true,
            packs: true,
            parallax,
            ..of(
                Preset::Card,
                [161, 123],
                (gray, Depth::U8),
                Settings { motion: Motion::Affine, max_relative_blur: Some(30.0), levels: Some(4), ..settings.clone() },
            )
        },
        Pair {
            is_masked: true,
            parallax,
            ..of(
                Preset::Bars,
                [97, 131],
                (rgb, Depth::U16),
                Settings {
                    kernel: Kernel::Pillbox,
                    motion: Motion::Homography,
                    relaxation_sweeps: 10,
                    decode: Decode::Srgb,
                    ..settings.clone()
                },
            )
        },
        Pair {
            is_masked: true,
            ..of(
                Preset::Relief,
                [131, 74],
                (gray, Depth::F32),
                Settings {
                    method: Method::Appearance,
                    motion: Motion::Homography,
                    kernel: Kernel::HalfGaussian,
                    relaxation_sweeps: 6,
                    ..settings.clone()
                },
            )
        },
        of(
            Preset::Blocks,
            [75, 61],
            (rgb, Depth::U8),
            Settings {
                motion: Motion::Translation,
                levels: Some(3),
                registration_step: RegistrationStep::GradientDescent,
                ..settings.clone()
            },
        ),
        // Without texture, and without overlap.
        Pair { is_flat: true, ..of(Preset::Plane, [41, 35], (gray, Depth::F32), settings.clone()) },
        of(
            Preset::Plane,
            [53, 33],
            (rgb, Depth::F32),
            Settings {
                method: Method::Aligned,
                start: Similarity::new(1e4, 0.0, 0.0, 1.0).into(),
                levels: Some(3),
                ..settings
            },
        ),
    ]
}

/// A sweep with a mask, by a camera that moves.
fn run_sweep(
    replay: ReplaySolve<'_>,
    [width, height]: [u32; 2],
    frames: usize,
    camera_moves: [f64; 2],
    settings: Settings,
) {
    let scene = Scene { width, height, noise: 0.003, camera_moves, ..Preset::Card.scene() };
    let frames = SweepScene { drift: 2.0, gain_drift: 0.03, ..SweepScene::new(scene, frames) }.render().unwrap().frames;
    let engine = Engine::new(&EngineOptions { device: Some("cpu".into()), ..EngineOptions::default() }).unwrap();
    let options = SweepOptions { settings, ..SweepOptions::default() };
    let mut solver = SweepSolver::for_frames(&engine, &frames, &options).unwrap();
    let picture = (0..width * height).map(|n| f32::from(n % width > 9)).collect();
    let mask = Some(Mask::from_image(&Frame::gray(width, height, picture).unwrap()));
    let options = SolveOptions { mask, ..SolveOptions::default() };
    replay(0, &mut || {
        let sweep = solver.solve(&frames, &options).unwrap();
        let has_parallax = sweep.parallax.iter().any(|moves| *moves != [0.0; 2]);
        assert_eq!(has_parallax, camera_moves != [0.0; 2]);
    });
}

macro_rules! devices {
    ($($name:ident: $devices:expr,)*) => {$(
        #[test]
        fn $name() {
            replay_on($devices, run_all);
        }
    )*};
}

devices! {
    processors_compute_each_dispatch_as_its_reference: [128, 256, 512].map(Device::Cpu).into(),
    vulkan_computes_each_dispatch_as_its_reference: vec![Device::Vulkan(Rig::new())],
}
