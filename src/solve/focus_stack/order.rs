//! Whether frames are in the order of their focus, and each is there once.
//!
//! Through a sweep every place becomes sharper up to one frame and less sharp from it on. A frame that stands in the wrong place breaks that
//! at most places; it is found as the frame whose move mends most of it. A sweep taken backwards is as good.

use super::laplacian::squared_laplacian;
use crate::base::{Decode, Frame, workers};
use crate::solve::resample::luminance;

/// The frames to solve, as they are to stand, each by its number among those given; and what there is to say.
pub(super) struct Order {
    pub(super) frames: Vec<usize>,
    pub(super) warnings: Vec<String>,
}

/// The longest side on which sharpness is compared, px: noise of single pixels is averaged out.
const LONGEST: usize = 512;
/// Places along either side, and octaves from that side on: what is far out of focus differs in the coarser ones.
const PLACES: usize = 12;
const OCTAVES: usize = 3;
/// The shortest side that has some px for each place of the coarsest octave.
const SHORTEST: usize = 96;
/// A move counts if the mean over places of what it mends is so many of its standard errors: over 53 sweeps of 4 to 41 frames none that
/// were in order had a move of 5 or that mended anything of note.
const ERRORS: f64 = 6.0;
/// Moves are certain if they mend this share together; of 349 neighbours swapped in those sweeps, 345 were.
const MENDED: f64 = 0.4;
/// What is broken is nothing below this share of how much sharpness changes altogether.
const NOTHING: f64 = 0.005;
/// How far a frame is moved at most.
const FURTHEST: usize = 8;

/// In which order frames stand; `stated` says that their positions are known, which then rule.
pub(super) fn judge(frames: &[Frame], stated: bool) -> Order {
    let mut warnings = Vec::new();
    let once = left_out(frames, stated, &mut warnings);
    let sharpness = workers::map(once.len(), |n| Sharpness::of(&frames[once[n]]));
    let sharpness: Option<Vec<_>> = sharpness.into_iter().collect();
    let unmoved = || (0..once.len()).collect::<Vec<_>>();
    let (found, certain) = sharpness.map_or((unmoved(), false), |sharpness| in_order(&logarithms(&sharpness)));
    let found: Vec<usize> = found.into_iter().map(|n| once[n]).collect();
    if found == once {
        return Order { frames: once, warnings };
    }
    let numbers: Vec<String> = found.iter().map(|n| (n + 1).to_string()).collect();
    let numbers = numbers.join(", ");
    warnings.push(if stated {
        format!("the frames seem to be out of order, and would fit as {numbers}; their positions are stated, and they are taken as given")
    } else if certain {
        format!("the frames were out of order, and are taken as {numbers}")
    } else {
        format!("the frames may be out of order, and would fit better as {numbers}; they are taken as given")
    });
    Order { frames: if certain && !stated { found } else { once }, warnings }
}

/// The frames but for those that are another once more.
fn left_out(frames: &[Frame], stated: bool, warnings: &mut Vec<String>) -> Vec<usize> {
    let mut once: Vec<usize> = Vec::new();
    for (n, frame) in frames.iter().enumerate() {
        let same = once.iter().find(|other| frames[**other].samples() == frame.samples());
        if let Some(other) = same {
            let told = if stated { "positions are stated, and both are taken" } else { "it is left out" };
            warnings.push(format!("frame {} is the same photograph as frame {}; {told}", n + 1, other + 1));
        }
        if same.is_none() || stated {
            once.push(n);
        }
    }
    once
}

/// The mean squared Laplacian at each place, octave by octave, as bright as the mean of the frame.
struct Sharpness([Vec<f32>; OCTAVES]);

impl Sharpness {
    /// `None` of a frame too small to tell.
    fn of(frame: &Frame) -> Option<Self> {
        let mut size = [frame.width() as usize, frame.height() as usize];
        let mut values = luminance(frame.intensities(Decode::None), frame.format().channels);
        while size[0].max(size[1]) > LONGEST {
            (values, size) = halved(&values, size);
        }
        if size[0].min(size[1]) < SHORTEST {
            return None;
        }
        let bright = (values.iter().sum::<f32>() / values.len() as f32).max(f32::MIN_POSITIVE).powi(2);
        Some(Self(std::array::from_fn(|_| {
            let found = at_places(&values, size).into_iter().map(|e| e / bright).collect();
            (values, size) = halved(&values, size);
            found
        })))
    }
}

/// Means of two by two pixels.
fn halved(values: &[f32], [width, height]: [usize; 2]) -> (Vec<f32>, [usize; 2]) {
    let size = [width / 2, height / 2];
    let pairs = values.chunks_exact(2 * width).take(size[1]).flat_map(|rows| {
        let (upper, lower) = rows.split_at(width);
        let both = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        both.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1]))
    });
    (pairs.collect(), size)
}

/// Without the border, at which a part of the Laplacian is missing.
fn at_places(values: &[f32], size @ [width, height]: [usize; 2]) -> Vec<f32> {
    let squares = squared_laplacian(values, size);
    let mut sums = vec![(0.0f32, 0.0f32); PLACES * PLACES];
    for (y, x) in (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| (y, x))) {
        let place = &mut sums[y * PLACES / height * PLACES + x * PLACES / width];
        *place = (place.0 + squares[y * width + x], place.1 + 1.0);
    }
    sums.into_iter().map(|(sum, count)| sum / count.max(1.0)).collect()
}

/// By frame, the logarithm at each octave and place; what the noisiest fiftieth has is added, below which nothing tells.
fn logarithms(frames: &[Sharpness]) -> Vec<Vec<f32>> {
    let floor = |octave: usize| {
        let mut all: Vec<f32> = frames.iter().flat_map(|frame| frame.0[octave].iter().copied()).collect();
        all.sort_by(f32::total_cmp);
        all[all.len() / 50].max(f32::MIN_POSITIVE)
    };
    let floors: Vec<f32> = (0..OCTAVES).map(floor).collect();
    let of = |frame: &Sharpness| {
        let octaves = frame.0.iter().zip(&floors);
        octaves.flat_map(|(values, floor)| values.iter().map(move |e| (e + floor).ln())).collect()
    };
    frames.iter().map(of).collect()
}

/// How much sharpness falls before each place's sharpest frame or rises after it, the mean over octaves; by place.
fn broken(logarithms: &[Vec<f32>], order: &[usize]) -> Vec<f64> {
    let mut places = vec![0.0; PLACES * PLACES];
    (0..OCTAVES * PLACES * PLACES).for_each(|feature| {
        let changes = || order.windows(2).map(|pair| logarithms[pair[1]][feature] - logarithms[pair[0]][feature]);
        let mut here: f32 = changes().map(|change| change.max(0.0)).sum();
        let mut least = here;
        for change in changes() {
            // The sharpest frame is one further on.
            here -= change;
            least = least.min(here);
        }
        let place = feature % (PLACES * PLACES);
        places[place] += f64::from(least) / OCTAVES as f64;
    });
    places
}

/// Moves frames one by one, as long as a move mends what is broken; the order, and whether it is certain.
fn in_order(logarithms: &[Vec<f32>]) -> (Vec<usize>, bool) {
    let given: Vec<usize> = (0..logarithms.len()).collect();
    let mut order = given.clone();
    let mut now = broken(logarithms, &order);
    let (first, all) = (mean(&now), changes(logarithms));
    for _ in 0..logarithms.len() {
        if mean(&now) < NOTHING * all {
            break;
        }
        let Some((next, gain)) = best_move(logarithms, &order, &now) else { break };
        if mean(&gain) < ERRORS * standard_error(&gain) {
            break;
        }
        now = broken(logarithms, &next);
        order = next;
    }
    let certain = first - mean(&now) > MENDED * first;
    (order, certain)
}

/// How much sharpness changes from frame to frame, altogether, the mean over places and octaves.
fn changes(logarithms: &[Vec<f32>]) -> f64 {
    let pairs = logarithms.windows(2).flat_map(|pair| pair[0].iter().zip(&pair[1]));
    pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / (OCTAVES * PLACES * PLACES) as f64
}

/// The order with one frame moved that mends most, and what it mends by place.
fn best_move(logarithms: &[Vec<f32>], order: &[usize], now: &[f64]) -> Option<(Vec<usize>, Vec<f64>)> {
    let count = order.len();
    let ends = |from: usize| from.saturating_sub(FURTHEST)..(from + FURTHEST + 1).min(count);
    let moves = (0..count).flat_map(|from| ends(from).filter(move |to| *to != from).map(move |to| (from, to)));
    let tried = moves.map(|(from, to)| {
        let mut next = order.to_vec();
        let frame = next.remove(from);
        next.insert(to, frame);
        let gain: Vec<f64> = now.iter().zip(broken(logarithms, &next)).map(|(now, then)| now - then).collect();
        (next, gain)
    });
    tried.max_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1))).filter(|(_, gain)| mean(gain) > 0.0)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn standard_error(values: &[f64]) -> f64 {
    let middle = mean(values);
    (values.iter().map(|v| (v - middle).powi(2)).sum::<f64>()).sqrt() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Samples};

    /// A slope in focus from frame 0 on the left to the last on the right: waves of 6 px and more, blurred in closed form.
    fn slope(count: u32) -> Vec<Frame> {
        let [width, height] = [192u32, 128];
        let frame = |n: u32| {
            let value = |i: u32| {
                let (x, y) = (f64::from(i % width), f64::from(i / width));
                let v = 2.0 * (f64::from(n) - x / f64::from(width) * f64::from(count - 1)).powi(2) + 0.3;
                let wave = |k: f64, angle: f64| {
                    (-v * k * k / 2.0).exp() * (k * (x * angle.cos() + y * angle.sin()) + 9.0 * angle).sin()
                };
                let waves: f64 = (0..12).map(|i| wave(0.1 + 0.08 * f64::from(i), 2.4 * f64::from(i))).sum();
                ((0.5 + 0.04 * waves).clamp(0.0, 1.0) * 65535.0).round() as u16
            };
            let samples = Samples::U16((0..width * height).map(value).collect());
            Frame::new(width, height, Channels::Gray, samples).unwrap()
        };
        (0..count).map(frame).collect()
    }

    fn judged(numbers: &[usize], stated: bool) -> (Vec<usize>, Vec<String>) {
        let frames = slope(7);
        let given: Vec<Frame> = numbers.iter().map(|n| frames[*n].clone()).collect();
        let order = judge(&given, stated);
        (order.frames.iter().map(|n| numbers[*n]).collect(), order.warnings)
    }

    #[test]
    fn what_is_in_order_stays_and_so_does_what_runs_backwards() {
        for numbers in [[0, 1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1, 0]] {
            assert_eq!(judged(&numbers, false), (numbers.to_vec(), Vec::new()));
        }
        // One frame left out is no disorder.
        assert_eq!(judged(&[0, 1, 2, 4, 5, 6], false), (vec![0, 1, 2, 4, 5, 6], Vec::new()));
    }

    #[test]
    fn swapped_frames_come_back_unless_positions_are_stated() {
        for numbers in [[0, 1, 3, 2, 4, 5, 6], [0, 2, 3, 4, 1, 5, 6], [1, 0, 2, 3, 4, 5, 6]] {
            let (found, warnings) = judged(&numbers, false);
            assert_eq!(found, [0, 1, 2, 3, 4, 5, 6], "{warnings:?}");
            assert!(warnings[0].contains("out of order, and are taken as"), "{warnings:?}");
            let (found, warnings) = judged(&numbers, true);
            assert!(found == numbers && warnings[0].contains("as given"), "{warnings:?}");
        }
    }

    #[test]
    fn a_frame_that_is_there_twice_is_left_out_unless_positions_are_stated() {
        let (found, warnings) = judged(&[0, 1, 2, 2, 3, 4], false);
        assert_eq!((found, warnings.len()), (vec![0, 1, 2, 3, 4], 1));
        assert!(warnings[0].contains("frame 4 is the same photograph as frame 3"), "{warnings:?}");
        assert_eq!(judged(&[0, 1, 2, 2, 3, 4], true).0, [0, 1, 2, 2, 3, 4]);
    }
}
