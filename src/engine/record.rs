//! The device memory of a script, its recording into command buffers that replay it, and the profile of a run.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use super::arguments::{Grid, Indirect, Place};
use super::plan::{Allocation, AllocationKind, HostAccess, Plan};
use super::script::{Action, Dispatch, Entry, Script};
use super::slot::Slot;
use super::stages::Pipelines;
use super::stages::state::State;
use super::vulkan::{Buffer, Clock, Device, Image, Kind, Recorder, Recording, Resource, Workgroups};
use crate::base::Error;

/// The image or buffer of each slot.
pub(crate) struct Workspace {
    images: BTreeMap<Slot, Arc<Image>>,
    buffers: BTreeMap<Slot, Arc<Buffer>>,
}

impl Workspace {
    /// The workspace of another frame in flight. Allocates its input and output buffers, and shares all others.
    pub(crate) fn beside(&self, device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        let mut beside = Self { images: self.images.clone(), buffers: self.buffers.clone() };
        for allocation in plan.pair_layout().iter().filter(|a| a.slot.is_of_one_pair() && a.is_mapped()) {
            beside.add(device, allocation)?;
        }
        Ok(beside)
    }

    /// Allocates a layout of the plan.
    pub(crate) fn new(device: &Arc<Device>, plan: &Plan, layout: &[Allocation]) -> Result<Self, Error> {
        let mut workspace = Self { images: BTreeMap::new(), buffers: BTreeMap::new() };
        for allocation in layout {
            workspace.add(device, allocation)?;
        }
        for (bank, weights) in plan.weights.banks.iter().enumerate() {
            let single: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
            workspace.buffer(Slot::Filters { bank }).write(bytemuck::cast_slice(&single))?;
        }
        Ok(workspace)
    }

    fn add(&mut self, device: &Arc<Device>, &Allocation { slot, kind }: &Allocation) -> Result<(), Error> {
        let name = format!("{slot:?}");
        match kind {
            AllocationKind::Image { size, layers, texel } => {
                self.images.insert(slot, Image::new(device, &name, size, layers, texel)?);
            }
            AllocationKind::Buffer { bytes, host } => {
                let allocate = match host {
                    HostAccess::None => Buffer::device_local,
                    HostAccess::Upload => Buffer::for_upload,
                    HostAccess::Exchange | HostAccess::Readback => Buffer::for_readback,
                    HostAccess::Results => Buffer::for_borrowed_readback,
                };
                self.buffers.insert(slot, allocate(device, &name, bytes)?);
            }
        }
        Ok(())
    }

    pub(crate) fn image(&self, slot: Slot) -> &Arc<Image> {
        &self.images[&slot]
    }

    pub(crate) fn buffer(&self, slot: Slot) -> &Arc<Buffer> {
        &self.buffers[&slot]
    }

    /// All images, which must be prepared once before their first use.
    pub(crate) fn images(&self) -> Vec<&Arc<Image>> {
        self.images.values().collect()
    }
}

/// Records a script.
pub(crate) fn record(
    device: &Arc<Device>,
    pipelines: &Pipelines,
    workspace: &Workspace,
    script: &Script,
    reading: Reading,
) -> Result<Recording, Error> {
    let dispatches = script.dispatches().count() as u32;
    let clock = match reading {
        Reading::Never => Clock::Never,
        Reading::Passes => Clock::Passes(dispatches),
        Reading::Dispatches => Clock::Dispatches(dispatches),
    };
    record_with(Recorder::new(device, clock)?, pipelines, workspace, script)
}

/// Records a script with a given recorder.
pub(crate) fn record_with(
    mut recorder: Recorder,
    pipelines: &Pipelines,
    workspace: &Workspace,
    script: &Script,
) -> Result<Recording, Error> {
    pipelines.prepare(script.dispatches().map(|dispatch| (dispatch.stage, dispatch.variant)))?;
    for (n, part) in script.parts.iter().enumerate() {
        let begins = part.begins.filter(|_| recorder.is_conditional());
        match part.continues.or(begins) {
            Some(level) => {
                recorder.next_part_unless_set((workspace.buffer(Slot::State), State::settled_at(level) as u64))?
            }
            None if n > 0 => recorder.next_part()?,
            None => {}
        }
        record_entries(&mut recorder, pipelines, workspace, &part.entries)?;
    }
    let mut recording = recorder.finish()?;
    recording.join_batches(script.parts.iter().map(|part| part.ends_batch));
    Ok(recording)
}

/// Records the entries of a part, with a barrier before each that waits. The device skips those that warp I2 again as a
/// whole unless they are needed.
fn record_entries(
    recorder: &mut Recorder,
    pipelines: &Pipelines,
    workspace: &Workspace,
    entries: &[Entry],
) -> Result<(), Error> {
    let mut condition = None;
    for Entry { action, waits, .. } in entries {
        let first = match action {
            Action::Dispatch(Dispatch { grid: Grid::Indirect(Indirect::IfMoved { level, .. }), .. }) => {
                Some(Indirect::IfMoved { level: *level, n: 0 }.word())
            }
            _ => None,
        };
        if first != condition {
            condition = first;
            recorder.only_if_set(first.map(|word| (workspace.buffer(Slot::Arguments), 4 * word as u64)));
        }
        if *waits {
            recorder.barrier();
        }
        match action {
            Action::Dispatch(dispatch) => record_dispatch(recorder, pipelines, workspace, dispatch)?,
            Action::Copy { from, to, levels } => {
                let offset = if *levels { std::mem::offset_of!(State, levels) as u64 } else { 0 };
                recorder.copy_buffer(workspace.buffer(*from), workspace.buffer(*to), offset);
            }
            Action::Clear { image, layers, .. } => recorder.clear_image(workspace.image(*image), layers.clone()),
            Action::Download { layers } => {
                let (results, to) = (workspace.image(Slot::Stacks), workspace.buffer(Slot::EndMaps));
                recorder.copy_image_to_buffer(results, 0..*layers, to);
            }
        }
    }
    Ok(())
}

fn record_dispatch(
    recorder: &mut Recorder,
    pipelines: &Pipelines,
    workspace: &Workspace,
    dispatch: &Dispatch,
) -> Result<(), Error> {
    let bound = dispatch.slots.iter().zip(dispatch.stage.bindings);
    let resources: Vec<Resource<'_>> = bound
        .map(|(&slot, binding)| match binding.kind {
            Kind::Image | Kind::Words => Resource::Image(workspace.image(slot)),
            Kind::Buffer => Resource::Buffer(workspace.buffer(slot)),
            Kind::Uniform => Resource::Uniform(workspace.buffer(slot)),
        })
        .collect();
    let groups = match dispatch.grid {
        Grid::Direct(groups) => Workgroups::Direct(groups),
        Grid::Indirect(indirect) => Workgroups::Indirect(workspace.buffer(Slot::Arguments), 4 * indirect.word() as u64),
    };
    let pipeline = pipelines.get(dispatch.stage, dispatch.variant)?;
    recorder.dispatch(&pipeline, &resources, &dispatch.constants, groups)
}

/// The phase in which the host waits for the device.
pub(crate) const SUBMIT_WAIT: &str = "submit-wait";

/// When the device's clock is read. On software devices a reading takes as long as a small dispatch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reading {
    Never,
    /// Between passes of different names.
    Passes,
    /// After every dispatch.
    Dispatches,
}

/// The phases of the host in order.
#[derive(Clone, Debug)]
pub(crate) struct Phases {
    started: Instant,
    /// The phases and their ends, ms since the start.
    pub(crate) ends_ms: Vec<(&'static str, f64)>,
}

impl Default for Phases {
    /// Starts the clock.
    fn default() -> Self {
        Self { started: Instant::now(), ends_ms: Vec::new() }
    }
}

impl Phases {
    /// Ends a phase.
    pub(crate) fn end(&mut self, name: &'static str) {
        self.ends_ms.push((name, self.started.elapsed().as_secs_f64() * 1e3));
    }

    /// The time that the host waited for the device, ms.
    pub(crate) fn waited_ms(&self) -> f64 {
        let ended = self.ends_ms.iter().position(|(name, _)| *name == SUBMIT_WAIT);
        ended.map_or(0.0, |n| self.ends_ms[n].1 - n.checked_sub(1).map_or(0.0, |before| self.ends_ms[before].1))
    }
}

/// A dispatch of a script, and whether it ran.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ran {
    /// Name of the shader.
    pub(crate) pass: &'static str,
    pub(crate) place: Place,
    /// Compulsory traffic: each input element read once, each output element written once.
    pub(crate) bytes: u64,
    /// Whether it had any workgroups.
    pub(crate) executed: bool,
}

/// The profile of one solve.
pub(crate) struct Profile {
    /// All recorded dispatches in order.
    pub(crate) dispatches: Vec<Ran>,
    /// Their ends on the device, ms since the first began; empty on devices without a clock.
    pub(crate) ends_ms: Vec<f64>,
    pub(crate) phases: Phases,
}

impl Profile {
    /// The dispatches that had any workgroups.
    pub(crate) fn executed(&self) -> impl Iterator<Item = &Ran> {
        self.dispatches.iter().filter(|dispatch| dispatch.executed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Depth, Format, Kernel, Settings};
    use crate::engine::script::{CountedPixels, accesses, compose};
    use crate::engine::vulkan::Access;
    use crate::engine::{open, testing};

    /// Barriers whose absence synchronization validation (1.3.239) does not report: the pass after the barrier, the
    /// slot, and its accesses before and after. `docs/reliability.md` says why each is needed.
    const UNREPORTED: [&str; 16] = [
        "ambiguity: UncertaintyTerms Read Update, UncertaintyTerms Update Update",
        "separable: Arguments Write Read",
        "copy of State to Progress: State Update Read",
        "edge_agree: Stacks Update Update",
        "edge_apply: Stacks Update Update",
        "edge_cells: Stacks Write Update",
        "edge_costs: Stacks Update Update",
        "edge_decide: Stacks Update Update",
        "edge_fuse: Stacks Write Update",
        "ingest: State Read Update",
        "ingest: State Update Update",
        "mask: State Update Update",
        "residual: UncertaintyTerms Write Write",
        "shape: Stacks Update Update",
        "shape: Stacks Write Update",
        "total_deviation: Stacks Update Update",
    ];

    fn name(action: &Action) -> String {
        match action {
            Action::Dispatch(dispatch) => dispatch.stage.shader.name.to_string(),
            Action::Copy { from, to, .. } => format!("copy of {from:?} to {to:?}"),
            Action::Clear { image, .. } => format!("clearing of {image:?}"),
            Action::Download { .. } => "download".to_string(),
        }
    }

    /// The slots that entry n shares with the entries since the last barrier, and both accesses.
    fn hazards(entries: &[Entry], n: usize) -> String {
        let since = entries[..n].iter().rposition(|entry| entry.waits).unwrap_or(0);
        let earlier: Vec<_> = entries[since..n].iter().flat_map(|entry| accesses(&entry.action)).collect();
        let mut shared = std::collections::BTreeSet::new();
        for (slot, now) in accesses(&entries[n].action) {
            for (_, before) in earlier.iter().filter(|(other, _)| *other == slot) {
                if [*before, now] != [Access::Read; 2] {
                    let slot: String = format!("{slot:?}").chars().take_while(|c| c.is_alphanumeric()).collect();
                    shared.insert(format!("{slot} {before:?} {now:?}"));
                }
            }
        }
        shared.into_iter().collect::<Vec<_>>().join(", ")
    }

    /// Each barrier of a solve is left out in turn: validation reports the hazard.
    #[test]
    fn validation_reports_each_missing_barrier() {
        if !testing::options().validation {
            return;
        }
        let device = open(&testing::options()).unwrap().as_vulkan().unwrap().clone();
        let pipelines = Pipelines::new(&device);
        let mut unreported = BTreeMap::<String, usize>::new();
        let (mut reported_count, mut all) = (0, 0);
        let plans = [(Kernel::Auto, false, 3), (Kernel::HalfGaussian, false, 9), (Kernel::Auto, true, 3)];
        for (kernel, may_pack, relaxation_sweeps) in plans {
            // Six iterations suffice: later ones repeat the first two. The finest of the three levels is warped.
            // With this limit both stacks of the coarsest level fit as floats.
            let max_relative_blur = may_pack.then_some(30.0);
            let settings =
                Settings { outer_iterations: 6, kernel, max_relative_blur, relaxation_sweeps, ..Settings::default() };
            let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
            let plan = Plan::new(160, 136, [gray; 2], &settings).unwrap();
            let plan = Plan { may_pack, ..plan };
            assert_eq!(plan.packs(&plan.pyramid[0]), may_pack);
            let workspace = Workspace::new(&device, &plan, &plan.pair_layout()).unwrap();
            let mut first = Recorder::new(&device, Clock::Never).unwrap();
            first.initialize(&workspace.images());
            first.finish().unwrap().run().unwrap();
            for pixels in [CountedPixels::All, CountedPixels::Unmasked] {
                let mut script = compose(&plan, pixels);
                let reported = |entries: &[Entry]| {
                    let mut recorder = Recorder::new(&device, Clock::Never).unwrap();
                    record_entries(&mut recorder, &pipelines, &workspace, entries).unwrap();
                    recorder.finish().unwrap();
                    !device.instance.take_messages().is_empty()
                };
                let mut known = std::collections::BTreeSet::new();
                for part in &mut script.parts {
                    assert!(!reported(&part.entries), "with every barrier");
                    for n in 0..part.entries.len() {
                        // Iterations repeat, so a barrier with the same entries before it is tested once.
                        let around = part.entries[n.saturating_sub(3)..=n].iter().map(|entry| name(&entry.action));
                        if !part.entries[n].waits || !known.insert(around.collect::<Vec<_>>()) {
                            continue;
                        }
                        all += 1;
                        part.entries[n].waits = false;
                        if reported(&part.entries) {
                            reported_count += 1;
                        } else {
                            let key = format!("{}: {}", name(&part.entries[n].action), hazards(&part.entries, n));
                            *unreported.entry(key).or_default() += 1;
                        }
                        part.entries[n].waits = true;
                    }
                }
            }
        }
        println!("barriers left out: {all}; reported: {reported_count}; not reported: {unreported:?}");
        let count: usize = unreported.values().sum();
        testing::note(
            "barriers",
            &format!("{all} left out, {reported_count} reported, {count} not, of {} kinds", unreported.len()),
        );
        let unknown: Vec<_> = unreported.keys().filter(|kind| !UNREPORTED.contains(&kind.as_str())).collect();
        assert!(unknown.is_empty(), "validation misses {unknown:?}");
    }
}
