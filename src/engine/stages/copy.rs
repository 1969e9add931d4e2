//! Copies an image.
//!
//! It is no part of the method: [`bench`](crate::internals::bench) measures the memory bandwidth with it.

use super::pass::{Memory, Pass};
use super::{Number, Raster};
use crate::engine::vulkan::Variant;

pub use super::interface::copy::*;

impl Pass for Bindings {
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
    use std::cell::RefCell;
    use std::sync::Arc;
    use std::time::Duration;

    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::base::Deadline;

    use crate::engine::vulkan::{Clock, Image, Pipeline, Recorder, Recording, Resource, Workgroups};

    /// Which of three parts end a batch.
    const BATCHES: [[bool; 3]; 4] = [[true; 3], [false, true, true], [false; 3], [true, false, true]];
    /// Which of the optional parts are wanted, and the last one that runs.
    const WANTED: [([bool; 2], usize); 4] =
        [([true, true], 2), ([true, false], 1), ([false, true], 2), ([false, false], 0)];

    /// What `run_parts` calls.
    #[derive(Clone, Debug, PartialEq)]
    enum Call {
        Decides(usize),
        Ended(usize),
    }

    /// A recording of three parts that copy a field each to the same image. All but the first are optional if
    /// `optional`.
    fn copies(rig: &Rig, fields: &[Field; 3], to: &Arc<Image>, optional: bool, clock: Clock) -> Recording {
        let pipeline = Arc::new(Pipeline::new(rig.device(), &STAGE).unwrap());
        let constants = Constants { width: 37, height: 21, layer: 0 };
        let mut recorder = Recorder::new(rig.device(), clock).unwrap();
        for (n, field) in fields.iter().enumerate() {
            match (n, optional) {
                (0, _) => {}
                (_, true) => recorder.next_optional_part().unwrap(),
                (_, false) => recorder.next_part().unwrap(),
            }
            let from = rig.field(field);
            let resources = [Resource::Image(&from), Resource::Image(to)];
            let groups = Workgroups::Direct(STAGE.groups([37, 21]));
            recorder.barrier();
            recorder.dispatch(&pipeline, &resources, bytemuck::bytes_of(&constants), groups).unwrap();
        }
        recorder.finish().unwrap()
    }

    #[test]
    fn skipped_parts_do_not_run() {
        let rig = Rig::new();
        let fields = [1, 2, 3].map(|seed| random_field(37, 21, seed));
        let to = rig.empty([37, 21], 1);
        for clock in [Clock::Never, Clock::Passes(8), Clock::Dispatches(8)] {
            let mut recording = copies(&rig, &fields, &to, true, clock);
            for (batches, (wanted, last)) in BATCHES.into_iter().flat_map(|batches| WANTED.map(|case| (batches, case)))
            {
                recording.join_batches(batches.into_iter());
                let calls = RefCell::new(Vec::new());
                let mut is_wanted = |part: usize| {
                    calls.borrow_mut().push(Call::Decides(part));
                    Ok(wanted[part - 1])
                };
                let deadline = Deadline::after(Duration::MAX);
                recording
                    .run_parts(3, deadline, &mut is_wanted, &mut |parts| calls.borrow_mut().push(Call::Ended(parts)))
                    .unwrap();
                let [first, second] = [1, 2].map(|part| [Call::Decides(part), Call::Ended(part + 1)]);
                let expected = [&[Call::Ended(1)], first.as_slice(), &second].concat();
                assert_eq!(*calls.borrow(), expected, "a part is decided on when those before it have ended");
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
    #[test]
    fn parts_of_a_batch_end_with_its_last() {
        let rig = Rig::new();
        let fields = [1, 2, 3].map(|seed| random_field(37, 21, seed));
        let (to, deadline) = (rig.empty([37, 21], 1), Deadline::after(Duration::MAX));
        let mut recording = copies(&rig, &fields, &to, false, Clock::Never);
        for batches in BATCHES {
            recording.join_batches(batches.into_iter());
            let mut ended = Vec::new();
            recording.run_parts(3, deadline, &mut |_| panic!("none is optional"), &mut |n| ended.push(n)).unwrap();
            assert_eq!(ended, [1, 2, 3]);
            rig.assert_close(&to, &fields[2..], 1e-7);
            // The last part of a run is waited for, whether it ends a batch or not.
            ended.clear();
            recording.run_parts(2, deadline, &mut |_| panic!("none is optional"), &mut |n| ended.push(n)).unwrap();
            assert_eq!(ended, [1, 2]);
            rig.assert_close(&to, &fields[1..2], 1e-7);
            recording.run_part(0, deadline).unwrap();
            rig.assert_close(&to, &fields[..1], 1e-7);
            recording.run_part(1, deadline).unwrap();
            rig.assert_close(&to, &fields[1..2], 1e-7);
            recording.run_part(2, deadline).unwrap();
            rig.assert_close(&to, &fields[2..], 1e-7);
            let value = recording.submit(2, &[]).unwrap();
            assert!(recording.wait(value, Duration::MAX, deadline).unwrap());
            assert_eq!(recording.completion().1, value);
            rig.assert_close(&to, &fields[1..2], 1e-7);
        }
    }
}
