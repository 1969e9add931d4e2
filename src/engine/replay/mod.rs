//! Whole solves, dispatch by dispatch on each device: each dispatch gets the inputs that it has on the CPU device, and
//! its outputs are compared with those of its CPU reference in double precision.

mod tests;

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

use super::cpu::observer::observing;
use super::script::{Dispatch, Executable};
use super::slot::Slot;
use super::stages::harness::{self, Rig};
use super::stages::pass::Memory;
use super::stages::stack::White;
use super::stages::state::{Double, DoubleState, State};
use super::stages::sums::Layout;
use super::stages::{Field, edge, relax, segments, system};
use super::vulkan::{Access, Buffer, Image, Kind, Resource, Variant};
use crate::base::workers::no_threads;
/// Single precision, of a few operations on numbers as large as the result. What Vulkan lets square roots, divisions,
/// exponentials and logarithms err by is within it, and no shader uses functions that may err by more.
const SINGLE: f64 = 3e-5;

/// By how much outputs of a pass may differ, as a share of the largest number of a layer or buffer.
fn tolerance(pass: &str, variant: Variant) -> f64 {
    match pass {
        // A step of 16 bits, where one rounds up and the other down.
        "separable" | "shape" | "subdivide" if variant.has(Variant::PACKED) => 3e-4,
        // A step of weights in half precision.
        "system_tiles" => 1e-3,
        // √(p (1 - p)) of p within 6e-8 of 1, times a jump.
        "edge_apply" => 1e-3,
        // Where both sides are about as probable, their probability counts ten times.
        "edge_refine" => 5e-4,
        // Logarithms of the little that elimination leaves of sums of squares.
        "lens_windows" => 1e-3,
        _ => SINGLE,
    }
}

/// Makes alike what a reference writes whole, and its shader only where there are edges.
fn prepare(dispatch: &Dispatch, before: &mut Memory<f64>) {
    for (&slot, binding) in dispatch.slots.iter().zip(dispatch.stage.bindings) {
        if slot == Slot::Partials && binding.access != Access::Read {
            before.put_numbers(slot.write(), Vec::new());
        }
    }
    let name = dispatch.stage.shader.name;
    let layers: &[usize] = match name {
        "edge_cells" => &[edge::EDGES],
        "edge_costs" if !dispatch.variant.has(Variant::SWEEP) => &[edge::COSTS, edge::REVERSED_COSTS],
        "edge_decide" => &[edge::OUTLINES[0], edge::OUTLINES[1], edge::DECISIONS],
        "edge_apply" => &[edge::COARSE_FAR, edge::COARSE_SHARE, edge::COARSE_NEAR, edge::COARSE_TOWARDS_NEAR],
        _ => &[],
    };
    let like = if name == "edge_cells" { dispatch.slots[0] } else { Slot::Stacks };
    for &n in layers {
        let all = before.layers_in(like);
        let Field { width, height, .. } = all[if like == Slot::Stacks { edge::EDGES } else { 0 }];
        before.set_layer(Slot::Stacks.write(), n, Field::zeros(width, height));
    }
    if name == "edge_apply" && dispatch.place.level == 0 {
        let (v, deviation) = (&before.layers_in(dispatch.slots[0])[0], &before.layers_in(Slot::Stacks)[1]);
        let masked = |x, y| if deviation.get(x, y).is_nan() { f64::NAN } else { v.get(x, y) };
        let masked = Field::from_fn(v.width, v.height, masked);
        before.set_layer(Slot::Stacks.write(), 0, masked);
    }
}

/// Shaders that no script here reaches, or whose reference runs elsewhere.
const ELSEWHERE: [&str; 2] = [
    // The CPU device gets photographs that the host has unpacked.
    "unpack",
    // It sums grids beyond the fifth, of sides of 512 pixels or more.
    "halve_grid",
];

/// What a binding holds, as devices store it.
#[derive(Clone, Debug)]
enum Contents {
    Image(Vec<Field>),
    /// Numbers, in rows of partial sums if their length is known.
    Numbers(Vec<f64>, Option<usize>),
    Words(Vec<u32>),
    Bytes(Vec<u8>),
    State(Box<DoubleState>),
}

impl Contents {
    /// What the n-th binding of a dispatch holds.
    fn of(memory: &Memory<f64>, dispatch: &Dispatch, n: usize) -> Self {
        let (binding, slot) = (&dispatch.stage.bindings[n], dispatch.slots[n]);
        if matches!(binding.kind, Kind::Image | Kind::Words) {
            let layers = memory.layers_in(slot);
            return Self::Image(match binding.name {
                "smoothed" => right_sides(layers),
                "weights" => interleaved(layers),
                _ => layers.to_vec(),
            });
        }
        match slot {
            Slot::Photograph { image } => Self::Bytes(memory.photograph_of(image).bytes().to_vec()),
            Slot::Mask => {
                let all = memory.photograph_of(0);
                let all = || vec![1; (all.width() * all.height()) as usize];
                Self::Bytes(memory.mask_bytes().map_or_else(all, <[u8]>::to_vec))
            }
            Slot::State => Self::State(memory.state_in(slot).clone().into()),
            Slot::Arguments | Slot::StartArguments | Slot::Tiles | Slot::Hidden => {
                Self::Words(memory.words(slot.read()).to_vec())
            }
            _ if binding.name == "listed" => Self::Words(memory.words(slot.read()).to_vec()),
            _ => {
                let row = match dispatch.stage.shader.name {
                    "linearise" | "appearance" => Some(Layout::of_variant(dispatch.variant).length),
                    "half_pair" => Some(Layout::of(dispatch.variant.has(Variant::PROJECTIVE)).length),
                    "system_tiles" => Some(system::SUMS),
                    _ => None,
                };
                Self::Numbers(memory.numbers_in(slot).to_vec(), row.filter(|_| slot == Slot::Partials))
            }
        }
    }
}

/// D and the right sides at their pixels, of those by color.
fn right_sides(layers: &[Field]) -> Vec<Field> {
    match layers {
        [d, red, black, ..] if red.data.len() == black.data.len() && red.width == d.width.div_ceil(2) => {
            vec![d.clone(), relax::both([red, black], d.width)]
        }
        _ => Vec::new(),
    }
}

/// The weights of both colors, four to a texel.
fn interleaved(layers: &[Field]) -> Vec<Field> {
    let color = |weights: &[Field]| {
        Field::from_fn(4 * weights[0].width, weights[0].height, |x, y| weights[x % 4].get(x / 4, y))
    };
    layers.chunks_exact(4).map(color).collect()
}

/// The slots that the CPU reference of a dispatch may read.
fn read(dispatch: &Dispatch) -> Vec<Slot> {
    [&dispatch.slots[..], &[Slot::State]].concat()
}

/// A device under test.
enum Device {
    /// The CPU device with vectors of at most this many bits.
    Cpu(u32),
    Vulkan(Rig),
}

/// A dispatch, and the layer from which on the CPU reference keeps the second of packed stacks.
struct Case<'a> {
    dispatch: &'a Dispatch,
    second: usize,
    before: &'a Memory<f64>,
    expected: Vec<Contents>,
}

impl Case<'_> {
    fn is_written(&self, n: usize) -> bool {
        self.dispatch.stage.bindings[n].access != Access::Read
    }

    /// White of the blur stacks in a slot if they are packed.
    fn white(&self, slot: Slot) -> Option<White> {
        let (bindings, variant) = (self.dispatch.stage.bindings, self.dispatch.variant);
        let joins = |access| {
            variant.has(Variant::JOINS) && self.dispatch.stage.shader.name == "separable" && access == Access::Read
        };
        let is_packed = self
            .dispatch
            .slots
            .iter()
            .zip(bindings)
            .any(|(of, b)| *of == slot && b.kind == Kind::Words && !joins(b.access));
        White::of(variant, self.before.state_in(Slot::State).white).filter(|_| is_packed)
    }

    /// What each binding holds after the dispatch.
    fn on(&self, device: &Device) -> Vec<Contents> {
        match device {
            Device::Cpu(bits) => {
                let mut memory: Memory<f32> = self.before.part(&read(self.dispatch));
                segments::WIDEST.set(*bits);
                no_threads::run(|| f32::run(self.dispatch, &mut memory));
                segments::WIDEST.set(512);
                let memory = memory.part(&self.dispatch.slots);
                (0..self.dispatch.slots.len()).map(|n| Contents::of(&memory, self.dispatch, n)).collect()
            }
            Device::Vulkan(rig) => self.on_vulkan(rig),
        }
    }

    fn on_vulkan(&self, rig: &Rig) -> Vec<Contents> {
        let (mut images, mut buffers) = (BTreeMap::<Slot, Arc<Image>>::new(), BTreeMap::<Slot, Arc<Buffer>>::new());
        for (n, &slot) in self.dispatch.slots.iter().enumerate() {
            if images.contains_key(&slot) || buffers.contains_key(&slot) {
                continue;
            }
            match (Contents::of(self.before, self.dispatch, n), &self.expected[n]) {
                (Contents::Image(before), Contents::Image(after)) => {
                    drop(images.insert(slot, self.image(rig, n, &before, after)));
                }
                (Contents::Numbers(before, _), Contents::Numbers(after, _)) => {
                    let count = after.len().max(before.len()).max(1 << 14);
                    let numbers = before.into_iter().chain(std::iter::repeat(0.0)).take(count);
                    drop(buffers.insert(slot, rig.numbers(numbers)));
                }
                (Contents::Words(mut words), _) => {
                    words.resize(words.len().max(1 << 14), 0);
                    drop(buffers.insert(slot, rig.upload(bytemuck::cast_slice(&words))));
                }
                (Contents::Bytes(mut bytes), _) => {
                    bytes.resize(bytes.len().next_multiple_of(4), 0);
                    drop(buffers.insert(slot, rig.upload(&bytes)));
                }
                (Contents::State(state), _) => {
                    drop(buffers.insert(slot, rig.upload(bytemuck::bytes_of(&State::single(&state)))));
                }
                _ => unreachable!("a slot holds the same before and after"),
            }
        }
        let bound = self.dispatch.slots.iter().zip(self.dispatch.stage.bindings);
        let resources: Vec<_> = bound
            .map(|(slot, binding)| match binding.kind {
                Kind::Image | Kind::Words => Resource::Image(&images[slot]),
                Kind::Buffer => Resource::Buffer(&buffers[slot]),
                Kind::Uniform => Resource::Uniform(&buffers[slot]),
            })
            .collect();
        let groups = self.before.groups(self.dispatch.grid);
        rig.run_bytes(self.dispatch.stage, self.dispatch.variant, &resources, &self.dispatch.constants, groups);
        let after = |(n, expected): (usize, &Contents)| {
            let slot = self.dispatch.slots[n];
            match expected {
                _ if !self.is_written(n) => expected.clone(),
                Contents::Image(after) => Contents::Image(self.layers(rig, &images[&slot], slot, after)),
                Contents::Numbers(after, row) => {
                    let all = rig.floats(&buffers[&slot]).into_iter().map(f64::from);
                    Contents::Numbers(all.take(if row.is_some() { usize::MAX } else { after.len() }).collect(), *row)
                }
                Contents::Words(after) => Contents::Words(rig.words(&buffers[&slot])[..after.len()].to_vec()),
                Contents::Bytes(_) => unreachable!("only `unpack` writes photographs"),
                Contents::State(_) => Contents::State(rig.value::<State>(&buffers[&slot]).double().into()),
            }
        };
        self.expected.iter().enumerate().map(after).collect()
    }

    /// An image with these layers in its corner, and no numbers beyond.
    fn image(&self, rig: &Rig, n: usize, before: &[Field], after: &[Field]) -> Arc<Image> {
        let is_weights = self.dispatch.stage.bindings[n].name == "weights";
        let [width, height] = [|f: &Field| f.width, |f: &Field| f.height]
            .map(|side| before.iter().chain(after).map(side).max().unwrap_or(0));
        let (width, height) = (width + if is_weights { 8 } else { 3 }, height + 2);
        let padded = |layer: Option<&Field>| {
            Field::from_fn(width, height, |x, y| {
                let Some(layer) = layer.filter(|layer| !layer.data.is_empty()) else { return 0.0 };
                if x < layer.width && y < layer.height { layer.get(x, y) } else { f64::NAN }
            })
        };
        let count = before.len().max(after.len()).max(1);
        let layers = |range: std::ops::Range<usize>| range.map(|n| padded(before.get(n))).collect::<Vec<_>>();
        match self.white(self.dispatch.slots[n]) {
            Some(white) => {
                // In the scratch image the second follows the first.
                let second = if self.dispatch.slots[n] == Slot::Stacks { self.second } else { 1 };
                rig.packed(&[layers(0..second), layers(second..2 * second)].concat(), white)
            }
            None if is_weights => rig.weights(&layers(0..2)),
            None => rig.image(&layers(0..count)),
        }
    }

    /// The corners of an image's layers as large as those expected.
    fn layers(&self, rig: &Rig, image: &Arc<Image>, slot: Slot, expected: &[Field]) -> Vec<Field> {
        let layers = match self.white(slot) {
            Some(white) => rig.unpacked(image, white),
            None => rig.layers(image),
        };
        let corner = |(layer, e): (&Field, &Field)| Field::from_fn(e.width, e.height, |x, y| layer.get(x, y));
        // Those that are not packed with others are not on the device.
        layers.iter().zip(expected).map(corner).chain(expected.iter().skip(layers.len()).cloned()).collect()
    }

    /// What differs on a device by more than the tolerance, and the largest difference.
    fn differences(&self, device: &Device) -> (f64, Vec<String>) {
        let (pass, actual) = (self.dispatch.stage.shader.name, self.on(device));
        let tolerance = tolerance(pass, self.dispatch.variant);
        let (mut most, mut found) = (0.0_f64, Vec::new());
        for n in (0..actual.len()).filter(|&n| self.is_written(n)) {
            let mut check = |what: &str, tolerance: f64, actual: &[f64], expected: &[f64]| {
                let (apart, problem) = compare(tolerance, actual, expected);
                found.extend(problem.map(|problem| {
                    let Dispatch { variant, place, stage, .. } = self.dispatch;
                    format!("{pass} {variant:?}, level {}: {} {what}: {problem}", place.level, stage.bindings[n].name)
                }));
                apart
            };
            match (&actual[n], &self.expected[n]) {
                (Contents::Image(actual), Contents::Image(expected)) => {
                    assert!(actual.len() == expected.len(), "{pass}: {} layers, not {}", actual.len(), expected.len());
                    for (layer, (actual, expected)) in actual.iter().zip(expected).enumerate() {
                        let mut expected = expected.data.clone();
                        if self.dispatch.variant.has(Variant::LISTED) {
                            // References compute all pixels, devices those of the listed tiles.
                            let before = self.before.layers_in(self.dispatch.slots[n]).get(layer);
                            let before = before.map_or(&[][..], |before| &before.data);
                            for ((e, a), b) in expected.iter_mut().zip(&actual.data).zip(before) {
                                *e = if a == b { *a } else { *e };
                            }
                        }
                        most = most.max(check(&format!("layer {layer}"), tolerance, &actual.data, &expected));
                    }
                }
                (Contents::Numbers(actual, row), Contents::Numbers(expected, _)) => match row {
                    Some(row) => {
                        let [actual, expected] = [actual, expected].map(|rows| totals(rows, *row));
                        most = most.max(check("sums", tolerance, &actual, &expected));
                    }
                    None => most = most.max(check("numbers", tolerance, actual, expected)),
                },
                (Contents::Words(actual), Contents::Words(expected)) => {
                    // A device lists cells as it finds them.
                    let sorted = |words: &[u32]| {
                        let mut words: Vec<f64> = words.iter().map(|&word| word.into()).collect();
                        if self.dispatch.stage.bindings[n].name == "listed" {
                            words.sort_by(f64::total_cmp);
                        }
                        words
                    };
                    check("words", 0.0, &sorted(actual), &sorted(expected));
                }
                (Contents::State(actual), Contents::State(expected)) => {
                    for (n, (a, e)) in numbers(actual).into_iter().zip(numbers(expected)).enumerate() {
                        if (a - e).abs() > 1e-5 {
                            check(&format!("member {n}"), 1e-3, &[a], &[e]);
                        }
                    }
                }
                other => panic!("{pass}: {other:?}"),
            }
        }
        (most, found)
    }
}

/// The totals of columns.
fn totals(numbers: &[f64], row: usize) -> Vec<f64> {
    (0..row).map(|n| numbers.chunks(row).filter_map(|row| row.get(n)).sum()).collect()
}

/// The members of a state.
fn numbers(state: &DoubleState) -> Vec<f64> {
    let number = |&word: &u32| {
        let float = f32::from_bits(word);
        // Counts are bits of denormal floats.
        if word == 0 || float.is_subnormal() { f64::from(word) } else { f64::from(float) }
    };
    bytemuck::cast_slice::<u8, u32>(bytemuck::bytes_of(&State::single(state))).iter().map(number).collect()
}

/// By how much numbers differ at most, as a share of the largest; and where, if it is more than the tolerance.
fn compare(tolerance: f64, actual: &[f64], expected: &[f64]) -> (f64, Option<String>) {
    assert_eq!(actual.len(), expected.len());
    let largest = expected.iter().filter(|e| e.is_finite()).fold(1e-3, |most: f64, e| most.max(e.abs()));
    let apart = |(a, e): (&f64, &f64)| match (a - e).abs() / largest {
        _ if a == e || a.is_nan() && e.is_nan() => 0.0,
        apart if apart.is_nan() => f64::INFINITY,
        apart => apart,
    };
    let all = actual.iter().zip(expected).map(apart).zip(0..);
    let (most, place) = all.max_by(|(a, _), (b, _)| a.total_cmp(b)).unwrap_or((0.0, 0));
    let problem = || format!("{} at {place}, not {}; largest {largest}", actual[place], expected[place]);
    (most, (most > tolerance).then(problem))
}

/// Shader, variant, level, whether of a later iteration than the first; and of a filter its constants.
type Alike = (&'static str, Variant, usize, bool, Vec<u8>);

/// The dispatches of scripts so far. Of those that are alike one is replayed.
#[derive(Default)]
struct Replay {
    devices: Vec<Device>,
    /// The variants of shaders that have run.
    covered: BTreeSet<(&'static str, Variant)>,
    /// The dispatches of this solve that were replayed.
    seen: BTreeSet<Alike>,
    differences: Vec<String>,
    /// The largest difference of each pass within its tolerance.
    largest: BTreeMap<&'static str, f64>,
}

impl Replay {
    fn replay(&mut self, dispatch: &Dispatch, before: &dyn Fn() -> Memory<f64>, second: usize) {
        let name = dispatch.stage.shader.name;
        let is_later = dispatch.place.iteration.is_some_and(|k| k > 0);
        let filter = if name == "separable" { &dispatch.constants[..] } else { &[] };
        if !self.seen.insert((name, dispatch.variant, dispatch.place.level, is_later, filter.to_vec())) {
            return;
        }
        self.covered.insert((name, dispatch.variant));
        let mut before = before();
        prepare(dispatch, &mut before);
        let mut after = before.part(&read(dispatch));
        f64::run(dispatch, &mut after);
        let expected = (0..dispatch.slots.len()).map(|n| Contents::of(&after, dispatch, n)).collect();
        let case = Case { dispatch, second, before: &before, expected };
        for device in &self.devices {
            let (most, found) = case.differences(device);
            let largest = self.largest.entry(name).or_default();
            *largest = most.max(*largest);
            self.differences.extend(found);
        }
    }
}

/// Runs what `run` dispatches on the CPU device in `replay` too.
fn replaying(replay: &Rc<RefCell<Replay>>, second: usize, run: &mut dyn FnMut()) {
    let replay = replay.clone();
    observing(Box::new(move |dispatch, memory| replay.borrow_mut().replay(dispatch, memory, second)), run);
}

/// Replays a solve: the layer from which on its CPU references keep the second of packed blur stacks, and what runs it.
type ReplaySolve<'a> = &'a mut dyn FnMut(usize, &mut dyn FnMut());

/// Replays all solves on devices.
fn replay_on(devices: Vec<Device>, run_all: fn(ReplaySolve<'_>)) {
    let of_vulkan = matches!(devices[..], [Device::Vulkan(_)]);
    let replay = Rc::new(RefCell::new(Replay { devices, ..Replay::default() }));
    run_all(&mut |second, solve| {
        replaying(&replay, second, solve);
        replay.borrow_mut().seen.clear();
    });
    let replay = replay.borrow();
    let is_covered = |name: &str| replay.covered.iter().any(|(covered, _)| *covered == name);
    let names = include_str!("../../../glsl/spirv/SOURCES").lines().filter_map(|line| line.split_once("glsl/"));
    let missing: Vec<_> = names
        .filter_map(|(_, file)| file.strip_suffix(".comp"))
        .filter(|name| !is_covered(name) && !ELSEWHERE.contains(name))
        .collect();
    for (pass, largest) in &replay.largest {
        if of_vulkan {
            harness::note(&format!("pass {pass}"), &format!("{largest:.0e}"));
        } else {
            println!("{pass} {largest:.0e}");
        }
    }
    assert!(replay.differences.is_empty(), "{:#?}", replay.differences);
    assert!(missing.is_empty(), "no script reaches {missing:?}");
}
