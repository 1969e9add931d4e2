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
    let mut parts = script.parts.iter().skip(1);
    // The first step after the latest barrier. A part may be left out, and with it its barriers: each begins with one.
    let (mut ordered_from, mut begins) = (0, true);
    for (index, step) in script.steps.iter().enumerate() {
        let waits = step.waits_for.is_some_and(|before| before >= ordered_from);
        let touches = !matches!(step.action, Action::ShowHost | Action::NextPart);
        if waits || (begins && touches) {
            recorder.barrier();
            (ordered_from, begins) = (index, false);
        }
        match &step.action {
            Action::Dispatch(dispatch) => pass(&mut recorder, pipelines, workspace, dispatch)?,
            Action::Copy { from, to, levels } => {
                let offset = if *levels { std::mem::offset_of!(State, levels) as u64 } else { 0 };
                recorder.copy(workspace.buffer(*from), workspace.buffer(*to), offset);
            }
            Action::Clear { image, .. } => recorder.clear(workspace.image(*image)),
            Action::Download { layers } => {
                let (stacks, results) = (workspace.image(Slot::Stacks), workspace.buffer(Slot::Results));
                recorder.download(stacks, workspace.size, *layers, results);
            }
            Action::ShowHost => recorder.host_barrier(),
            Action::NextPart => {
                begins = true;
                match parts.next().and_then(|part| part.goes_on) {
                    Some(_) => recorder.next_part_if_wanted()?,
                    None => recorder.next_part()?,
                }
            }
        }
    }
    recorder.finish()
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
    let groups = match (dispatch.grid, dispatch.grid.word()) {
        (_, Some(word)) => Groups::Indirect(workspace.buffer(Slot::Arguments), 4 * word as u64),
        (Grid::Direct(groups), None) => Groups::Direct(groups),
        (_, None) => Groups::Direct([1; 3]),
    };
    let pipeline = pipelines.get(dispatch.stage, dispatch.variant)?;
    recorder.pass(&pipeline, &resources, &dispatch.constants, groups)
}
