//! A field as it is, from image to image. No part of the method: [`bench`](crate::internals::bench) measures by it what the memory
//! under the other passes does at most.

use bytemuck::{Pod, Zeroable};

use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::{Field, pixels};
use crate::engine::vulkan::{Stage, Variant};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The layer where it goes.
    pub layer: u32,
}

bindings! {
    COPY:
    /// From.
    from: Reads<Plane>,
    /// To.
    to: Writes<Plane>,
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: every pixel read, every pixel written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let copied = twin(memory.layer(self.from, 0));
        memory.set_layer(self.to, c.layer as usize, copied);
    }
}

/// The same field.
pub fn twin(from: &Field) -> Field {
    from.clone()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::base::Deadline;
    use crate::engine::vulkan::{Clock, Groups, Pipeline, Recorder, Resource};

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(37, 21), (64, 4), (1, 1)] {
            let rig = Rig::new();
            let field = random_field(width, height, 5);
            let size = [width as u32, height as u32];
            let (from, to) = (rig.image(std::slice::from_ref(&field)), rig.empty(size, 1));
            let constants = Constants { width: size[0], height: size[1], layer: 0 };
            rig.run(&STAGE, &[Resource::Image(&from), Resource::Image(&to)], &constants, size);
            // 1e-7: the field in single precision.
            rig.assert_close(&to, &[twin(&field)], 1e-7);
        }
    }

    #[test]
    fn parts_that_are_not_wanted_are_left_out() {
        let rig = Rig::new();
        let fields = [1, 2, 3].map(|seed| random_field(37, 21, seed));
        let sources = fields.each_ref().map(|field| rig.image(std::slice::from_ref(field)));
        let to = rig.empty([37, 21], 1);
        let pipeline = Arc::new(Pipeline::new(rig.device(), &STAGE).unwrap());
        let constants = Constants { width: 37, height: 21, layer: 0 };
        for clock in [Clock::Never, Clock::Passes(8), Clock::Dispatches(8)] {
            let mut recorder = Recorder::new(rig.device(), clock).unwrap();
            for (n, from) in sources.iter().enumerate() {
                if n > 0 {
                    recorder.next_part_if_wanted().unwrap();
                }
                let resources = [Resource::Image(from), Resource::Image(&to)];
                let groups = Groups::Direct(STAGE.groups([37, 21]));
                recorder.barrier();
                recorder.pass(&pipeline, &resources, bytemuck::bytes_of(&constants), groups).unwrap();
            }
            let mut recording = recorder.finish().unwrap();
            for (wanted, last) in [([true, true], 2), ([true, false], 1), ([false, true], 2), ([false, false], 0)] {
                let mut ended = Vec::new();
                let deadline = Deadline::after(Duration::MAX);
                recording
                    .run_first(3, deadline, &mut |part| Ok(wanted[part - 1]), &mut |parts| ended.push(parts))
                    .unwrap();
                assert_eq!(ended, [1, 2, 3], "whoever watches hears of every part");
                rig.assert_close(&to, &[fields[last].clone()], 1e-7);
                let times = recording.times().unwrap();
                let spans = if matches!(clock, Clock::Never) { 0 } else { 3 };
                assert_eq!(times.ends_ms.len(), spans);
                assert!(times.ends_ms.is_sorted(), "{times:?}");
                for part in (1..spans).filter(|&part| !wanted[part - 1]) {
                    assert_eq!(times.ends_ms[part], times.ends_ms[part - 1], "what is left out takes no time");
                }
            }
        }
    }
}
