//! A script on a device: command buffers that can be replayed for any number of pairs.

use std::sync::Arc;

use super::arguments::Grid;
use super::script::{Action, Dispatch, Script};
use super::slot::Slot;
use super::stages::Pipelines;
use super::stages::state::State;
use super::vulkan::{Clock, Device, Groups, Kind, Recorder, Recording, Resource};
use super::workspace::Workspace;
use crate::base::Error;

/// Records a script. The device's clock is read where a pass follows one of another name, or, if `traced`, after every
/// dispatch, which takes time itself.
pub(crate) fn record(
    device: &Arc<Device>,
    pipelines: &Pipelines,
    workspace: &Workspace,
    script: &Script,
    traced: bool,
) -> Result<Recording, Error> {
    let clock = if traced { Clock::Dispatches } else { Clock::Passes };
    let mut recorder = Recorder::new(device, clock(script.dispatches().count() as u32))?;
    for (n, part) in script.parts.iter().enumerate() {
        match part.goes_on {
            Some(_) => recorder.next_part_if_wanted()?,
            None if n > 0 => recorder.next_part()?,
            None => {}
        }
        for entry in &part.entries {
            if entry.waits {
                recorder.barrier();
            }
            act(&mut recorder, pipelines, workspace, &entry.action)?;
        }
    }
    recorder.finish()
}

fn act(recorder: &mut Recorder, pipelines: &Pipelines, workspace: &Workspace, action: &Action) -> Result<(), Error> {
    match action {
        Action::Dispatch(dispatch) => return pass(recorder, pipelines, workspace, dispatch),
        Action::Copy { from, to, levels } => {
            let offset = if *levels { std::mem::offset_of!(State, levels) as u64 } else { 0 };
            recorder.copy(workspace.buffer(*from), workspace.buffer(*to), offset);
        }
        Action::Clear { image, .. } => recorder.clear(workspace.image(*image)),
        Action::Download { layers } => {
            recorder.download(workspace.image(Slot::Stacks), *layers, workspace.buffer(Slot::EndMaps));
        }
    }
    Ok(())
}

fn pass(
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
        Grid::Direct(groups) => Groups::Direct(groups),
        Grid::Level { .. } | Grid::IfMoved { .. } => {
            let word = dispatch.grid.word().unwrap_or_default() as u64;
            Groups::Indirect(workspace.buffer(Slot::Arguments), 4 * word)
        }
    };
    let pipeline = pipelines.get(dispatch.stage, dispatch.variant)?;
    recorder.pass(&pipeline, &resources, &dispatch.constants, groups)
}
