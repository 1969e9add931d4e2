//! Generated stacks with their truth, which others made.

use std::path::Path;

use super::truth::{Errors, judged, solved};
use crate::base::{Decode, Error, Frame};
use crate::files::image_io;
use crate::lab::baseline::shape_from_focus;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::section::{Case, Section};

/// Within the data.
const FOLDER: &str = "cou";
const STACKS: [&str; 3] = ["1", "2", "3"];
/// Every so many-th frame, and the bound of the median error, frames.
const STEPS: [(usize, f64); 4] = [(1, 0.045), (2, 0.055), (4, 0.09), (8, 0.12)];
/// Of which a quick run solves these.
const QUICK: &[(usize, f64)] = STEPS.split_at(2).1;
/// A stack has no more frames than this.
const MOST_FRAMES: usize = 999;

/// Every stack with all frames and with fewer.
pub(super) fn section(bench: &mut Bench, data: &Path) -> Section {
    let (stacks, steps) = if bench.quick { (&STACKS[..1], QUICK) } else { (&STACKS[..], &STEPS[..]) };
    let cases = stacks.iter().flat_map(|name| cases(bench, &data.join(FOLDER), name, steps)).collect();
    let what =
        "Corentin Cou's generated stacks, 41 frames of JPEG, all of them and every 2nd, 4th and 8th, by default \
                settings; below each, shape from focus (modified Laplacian, window of σ 4 px). A pixel without an answer \
                counts as off by more than a frame."
            .to_string();
    Section { name: "Generated stacks", what, cases }
}

fn cases(bench: &mut Bench, folder: &Path, name: &str, steps: &[(usize, f64)]) -> Vec<Case> {
    let stack = match Stack::read(&folder.join(name)) {
        Ok(stack) => stack,
        Err(e) => return vec![Case::failed(format!("stack {name}"), e)],
    };
    let mut cases = Vec::new();
    for (step, most) in steps {
        let (frames, positions) = stack.every(*step);
        let name = format!("stack {name}, {} frames", frames.len());
        bench.say(&format!("sweeps: {name}"));
        cases.push(match solved(bench.engine(), &frames, positions.clone()) {
            Ok(sweep) => judged(&sweep, &stack.truth, &stack.known(), name.clone(), *most),
            Err(e) => Case::failed(name.clone(), e),
        });
        let name = format!("{name}: shape from focus");
        cases.push(match shape_from_focus(&frames, &positions, Decode::None) {
            Ok(focus) => Errors::of(focus.into_iter().zip(stack.truth.iter().copied())).told(name),
            Err(e) => Case::failed(name, e.to_string()),
        });
    }
    cases
}

struct Stack {
    frames: Vec<Frame>,
    /// The frame in focus at each pixel, from 0; NaN where that is not known.
    truth: Vec<f32>,
}

impl Stack {
    /// `image_1.jpg` and so on, as many as there are, and `truth.exr`.
    fn read(folder: &Path) -> Result<Self, String> {
        let file = |n: usize| folder.join(format!("image_{n}.jpg"));
        let count = (2..=MOST_FRAMES).find(|n| !file(*n).is_file()).unwrap_or(MOST_FRAMES + 1) - 1;
        let read = || {
            let (width, height, truth) = image_io::read_field(&folder.join("truth.exr"))?;
            let frames = (1..=count).map(|n| image_io::read(&file(n))).collect::<Result<Vec<Frame>, Error>>()?;
            Ok::<_, Error>((Self { frames, truth }, [width, height]))
        };
        let (stack, size) = read().map_err(|e| e.to_string())?;
        let other = stack.frames.iter().position(|frame| [frame.width(), frame.height()] != size);
        match other {
            None => Ok(stack),
            Some(n) => Err(format!("truth.exr is {size:?} px and image_{}.jpg is not", n + 1)),
        }
    }

    /// Every so many-th frame from the first on, and where it stands.
    fn every(&self, step: usize) -> (Vec<Frame>, Vec<f64>) {
        let taken = || (0..self.frames.len()).step_by(step);
        (taken().map(|k| self.frames[k].clone()).collect(), taken().map(|k| k as f64).collect())
    }

    /// The pixels whose focus is known.
    fn known(&self) -> Vec<usize> {
        (0..self.truth.len()).filter(|&i| self.truth[i].is_finite()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_absent_or_of_another_size_is_a_sentence() {
        let folder = tempfile::TempDir::new().unwrap();
        let read = || Stack::read(folder.path()).err().unwrap();
        assert!(read().contains("truth.exr") && read().contains("no such file"), "{}", read());
    }

    #[test]
    fn of_frames_that_are_left_out_the_others_keep_their_numbers() {
        let frame = Frame::gray(16, 16, vec![0.5; 256]).unwrap();
        let stack = Stack { frames: vec![frame; 41], truth: vec![f32::NAN, 3.0] };
        for (step, count) in [(1, 41), (2, 21), (4, 11), (8, 6)] {
            let (frames, positions) = stack.every(step);
            assert_eq!((frames.len(), positions[count - 1]), (count, 40.0));
        }
        assert_eq!(stack.known(), [1]);
    }
}
