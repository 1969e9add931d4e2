//! Copies an image.
//!
//! It is no part of the method: [`bench`](crate::internals::bench) measures the memory bandwidth with it.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width, pixels.
    width: u32,
    /// Height, pixels.
    height: u32,
    /// Target layer.
    layer: u32,
}

bindings! {
    COPY:
    from: Reads<Plane>,
    to: Writes<Plane>,
}

impl Pass for Bindings {
    /// Compulsory traffic: every pixel read, every pixel written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let copied = cpu_reference(memory.layer(self.from, 0));
        memory.set_layer(self.to, c.layer as usize, copied);
    }
}

/// The same field.
pub fn cpu_reference<N: Number>(from: &Raster<N>) -> Raster<N> {
    from.clone()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::super::harness::{Input, Rig, Trial, random_field};
    use super::*;
    use crate::base::Deadline;
    use crate::engine::stages::NO_VARIANT;
    use crate::engine::vulkan::{Clock, Pipeline, Recorder, Resource, Workgroups};

    #[test]
    fn matches_the_cpu_reference() {
        for size in [[37u32, 21u32], [64, 4], [1, 1]] {
            let [width, height] = size;
            let field = [random_field(width as usize, height as usize, 5)];
            let inputs = [Input::Image(&field), Input::Unread];
            let constants = Constants { width, height, layer: 0 };
            // 1e-7: the field in single precision.
            Trial::run::<Bindings>(&inputs, &constants, NO_VARIANT, STAGE.groups(size)).assert_within(1e-7);
        }
    }

    #[test]
    fn skipped_parts_do_not_run() {
        let rig = Rig::new();
        let fields = [1, 2, 3].map(|seed| random_field(37, 21, seed));
        let sources = fields.each_ref().map(|field| rig.field(field));
        let to = rig.empty([37, 21], 1);
        let pipeline = Arc::new(Pipeline::new(rig.device(), &STAGE).unwrap());
        let constants = Constants { width: 37, height: 21, layer: 0 };
        for clock in [Clock::Never, Clock::Passes(8), Clock::Dispatches(8)] {
            let mut recorder = Recorder::new(rig.device(), clock).unwrap();
            for (n, from) in sources.iter().enumerate() {
                if n > 0 {
                    recorder.next_optional_part().unwrap();
                }
                let resources = [Resource::Image(from), Resource::Image(&to)];
                let groups = Workgroups::Direct(STAGE.groups([37, 21]));
                recorder.barrier();
                recorder.dispatch(&pipeline, &resources, bytemuck::bytes_of(&constants), groups).unwrap();
            }
            let mut recording = recorder.finish().unwrap();
            for (wanted, last) in [([true, true], 2), ([true, false], 1), ([false, true], 2), ([false, false], 0)] {
                let mut ended = Vec::new();
                let deadline = Deadline::after(Duration::MAX);
                recording
                    .run_parts(3, deadline, &mut |part| Ok(wanted[part - 1]), &mut |parts| ended.push(parts))
                    .unwrap();
                assert_eq!(ended, [1, 2, 3], "the callback is called for each part");
                rig.assert_close(&to, &[fields[last].clone()], 1e-7);
                let times = recording.times().unwrap();
                let spans = if matches!(clock, Clock::Never) { 0 } else { 3 };
                assert_eq!(times.ends_ms.len(), spans);
                assert!(times.ends_ms.is_sorted(), "{times:?}");
                for part in (1..spans).filter(|&part| !wanted[part - 1]) {
                    assert_eq!(times.ends_ms[part], times.ends_ms[part - 1], "a skipped part takes no time");
                }
            }
        }
    }
}
