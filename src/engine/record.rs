//! Records a script into command buffers, which can be replayed for any number of pairs.

use std::sync::Arc;

use super::arguments::Grid;
use super::profile::Reading;
use super::script::{Action, Dispatch, Entry, Script};
use super::slot::Slot;
use super::stages::Pipelines;
use super::stages::state::State;
use super::vulkan::{Clock, Device, Kind, Recorder, Recording, Resource, Workgroups};
use super::workspace::Workspace;
use crate::base::Error;

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
    recorder.finish()
}

/// Records the entries of a part, with a barrier before each that waits.
fn record_entries(
    recorder: &mut Recorder,
    pipelines: &Pipelines,
    workspace: &Workspace,
    entries: &[Entry],
) -> Result<(), Error> {
    entries.iter().try_for_each(|entry| {
        if entry.waits {
            recorder.barrier();
        }
        record_action(recorder, pipelines, workspace, &entry.action)
    })
}

fn record_action(
    recorder: &mut Recorder,
    pipelines: &Pipelines,
    workspace: &Workspace,
    action: &Action,
) -> Result<(), Error> {
    match action {
        Action::Dispatch(dispatch) => return record_dispatch(recorder, pipelines, workspace, dispatch),
        Action::Copy { from, to, levels } => {
            let offset = if *levels { std::mem::offset_of!(State, levels) as u64 } else { 0 };
            recorder.copy_buffer(workspace.buffer(*from), workspace.buffer(*to), offset);
        }
        Action::Clear { image, .. } => recorder.clear_image(workspace.image(*image)),
        Action::Download { layers } => {
            recorder.copy_image_to_buffer(workspace.image(Slot::Stacks), 0..*layers, workspace.buffer(Slot::EndMaps));
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
            Kind::Image => Resource::Image(workspace.image(slot)),
            Kind::Buffer => Resource::Buffer(workspace.buffer(slot)),
            Kind::Uniform => Resource::Uniform(workspace.buffer(slot)),
        })
        .collect();
    let groups = match dispatch.grid {
        Grid::Direct(groups) => Workgroups::Direct(groups),
        Grid::Level { .. } | Grid::IfMoved { .. } => {
            let word = dispatch.grid.word().unwrap_or_default() as u64;
            Workgroups::Indirect(workspace.buffer(Slot::Arguments), 4 * word)
        }
    };
    let pipeline = pipelines.get(dispatch.stage, dispatch.variant)?;
    recorder.dispatch(&pipeline, &resources, &dispatch.constants, groups)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::base::{Channels, Depth, Format, Kernel, Settings};
    use crate::engine::plan::Plan;
    use crate::engine::script::{accesses, compose};
    use crate::engine::vulkan::Access;
    use crate::engine::{open, testing};

    /// Barriers whose absence synchronization validation (1.3.239) does not report: the pass after the barrier, the
    /// slot, and its accesses before and after. `docs/reliability.md` says why each is needed.
    const UNREPORTED: [&str; 7] = [
        "convolve: Stacks Write Update",
        "apply_shading: Stacks Update Write",
        "apply_shading: Stacks Write Write",
        "convolve: Arguments Write Read",
        "residual: UncertaintyTerms Write Write",
        "shape: Stacks Update Update",
        "shape: Stacks Write Update",
    ];

    /// The name of an action.
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
        let device = open(&testing::options()).unwrap();
        let pipelines = Pipelines::new(&device);
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let mut unreported = BTreeMap::<String, usize>::new();
        let (mut reported_count, mut all) = (0, 0);
        for kernel in [Kernel::Auto, Kernel::HalfGaussian] {
            // Later iterations repeat the first two; of three levels the finest is warped.
            let settings = Settings { outer_iterations: 6, kernel, ..Settings::default() };
            let plan = Plan::new(160, 136, [gray; 2], &settings).unwrap();
            let workspace = Workspace::new(&device, &plan).unwrap();
            let mut first = Recorder::new(&device, Clock::Never).unwrap();
            first.initialize(&workspace.images());
            first.finish().unwrap().run().unwrap();
            for masked in [false, true] {
                let mut script = compose(&plan, masked);
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
                        // Iterations repeat: barriers between the same entries are the same.
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
