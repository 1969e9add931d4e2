//! Decides which frames of a sweep are solved, and in which order: repeated and foreign frames are left out.
//!
//! Across a sweep each place of the image becomes sharper up to one frame, and less sharp after it. A frame out of
//! order violates this at most places, and differs from its neighbours. The order is the path through all frames with
//! the least of both. A reversed sweep is in order.

use super::foreign::{Coarse, Foreign, foreign, halved, merged};
use super::fuse::squared_laplacian;
use crate::base::statistics::median;
use crate::base::{Decode, Error, Frame, workers};
use crate::solve::resample::luminance;

/// The least number of frames of a sweep.
pub(super) const MIN_FRAMES: usize = 3;

/// The frames to solve in order, by their index among those passed, and warnings.
pub(super) struct Order {
    pub(super) frames: Vec<usize>,
    pub(super) warnings: Vec<String>,
    /// Whether the contrast of some frame shows that it differs in focus.
    pub(super) differ_in_focus: bool,
}

/// The least difference of the logarithms of fine and coarse detail, in the median over the places, between frames that
/// differ in focus. It is 1.1 to 2.8 in six real sweeps, and 0.5 and more in simulated ones that blur by 0.8 to 10 px, and up
/// to 0.45 for one setting with noise of 0.05, or where frames move by 12 px or grow by 10 %.
const DIFFERENT: f64 = 0.6;

/// The longest side on which sharpness is compared, px. The reduction averages out the noise of single pixels.
const LONGEST: usize = 512;
/// The number of places along either side.
const PLACES: usize = 12;
/// The number of octaves, from the longest side on. Frames far out of focus differ in the coarser octaves.
const OCTAVES: usize = 3;
/// The least side, so that each place of the coarsest octave has some pixels.
const SHORTEST: usize = 96;
/// The weight of the total change of sharpness from frame to frame, beside the violation. It decides where the violation
/// does not: a blurred frame may lie on either side of a scene at one distance, but not beside a sharp one. With 0, of 34
/// simulated sweeps 20 had a better order than the true one, with 0.05 three, by up to 0.003 of the change.
const CHANGE: f64 = 0.05;
/// The least significance of another order: the mean of what it repairs over the places, in standard errors.
const MIN_SIGNIFICANCE: f64 = 6.0;
/// The least that another order must repair to be taken, and to be named, as a share of the total change. Of 9 real and 60
/// simulated sweeps in order, half of them of scenes within a third of the range, none reached the second. [`CHANGE`] was
/// counted there, which repairs more.
const MIN_REPAIRED: [f64; 2] = [0.02, 0.01];

/// The most runs of frames that are moved: each takes a second for 999 frames.
const MOST_MOVES: usize = 64;

/// How frames are judged.
#[derive(Clone, Copy, Default)]
pub(super) struct Rules {
    /// Whether their positions are stated, so that their order does not change.
    pub(super) stated: bool,
    /// Whether foreign frames are kept, so that warnings alone say which they are.
    pub(super) keep_foreign: bool,
}

/// Determines which frames are solved, and their order.
///
/// # Errors
/// [`Error::Mismatch`] if fewer than three frames, or no more than half of them, differ and show one scene.
pub(super) fn judge(frames: &[Frame], rules: Rules) -> Result<Order, Error> {
    let mut warnings = Vec::new();
    let distinct = without_repetitions(frames, rules, &mut warnings);
    let reduced = workers::map(distinct.len(), |n| Reduced::of(&frames[distinct[n]]));
    let Some(reduced) = reduced.into_iter().collect::<Option<Vec<_>>>() else {
        return Ok(Order { frames: enough(distinct, frames.len())?, warnings, differ_in_focus: false });
    };
    let (kept, logarithms) = without_foreign(&distinct, reduced, rules, &mut warnings);
    let kept = enough(kept, frames.len())?;
    let differ_in_focus = differ_in_focus(&logarithms);
    let (best, certain) = in_order(&logarithms);
    let best: Vec<usize> = best.into_iter().map(|n| kept[n]).collect();
    if best == kept {
        return Ok(Order { frames: kept, warnings, differ_in_focus });
    }
    let numbers: Vec<String> = best.iter().map(|n| (n + 1).to_string()).collect();
    let numbers = numbers.join(", ");
    warnings.push(if rules.stated {
        format!("the frames seem to be out of order, and would fit as {numbers}; their positions are stated, and they are taken as given")
    } else if certain {
        format!("the frames were out of order, and are taken as {numbers}")
    } else {
        format!("the frames may be out of order, and would fit better as {numbers}; they are taken as given")
    });
    Ok(Order { frames: if certain && !rules.stated { best } else { kept }, warnings, differ_in_focus })
}

/// Returns the frames that are kept of those passed, or an error if they are too few.
fn enough(kept: Vec<usize>, passed: usize) -> Result<Vec<usize>, Error> {
    let count = kept.len();
    if count >= MIN_FRAMES && 2 * count > passed {
        return Ok(kept);
    }
    let least = MIN_FRAMES.max(passed / 2 + 1);
    Err(Error::Mismatch(format!(
        "only {count} of {passed} frames differ and show one scene: a sweep needs {least} of them; remove the others, or \
         keep them all (keep_frames)"
    )))
}

/// The frames that show the scene of most frames, and the logarithms of their sharpness. `distinct` has the index of
/// each frame among those passed.
fn without_foreign(
    distinct: &[usize],
    reduced: Vec<Reduced>,
    rules: Rules,
    warnings: &mut Vec<String>,
) -> (Vec<usize>, Vec<Vec<f32>>) {
    let (sharpness, coarse): (Vec<_>, Vec<_>) =
        reduced.into_iter().map(|frame| (frame.sharpness, frame.coarse)).unzip();
    let best = best_order(&logarithms(&sharpness.iter().collect::<Vec<_>>()));
    let mut reasons = foreign(&coarse, &best);
    let showing: Vec<usize> = best.into_iter().filter(|&n| reasons[n].is_none()).collect();
    let of_scene: Vec<_> = showing.iter().map(|n| &sharpness[*n]).collect();
    let are_merged = merged(&logarithms(&of_scene), PLACES * PLACES);
    showing.iter().zip(are_merged).filter(|(_, is)| *is).for_each(|(&n, _)| reasons[n] = Some(Foreign::Merged));
    for (n, reason) in reasons.iter().enumerate() {
        if let Some(reason) = reason {
            let action = if rules.keep_foreign { "it is kept as asked" } else { "it is left out" };
            warnings.push(format!("frame {} {}; {action}", distinct[n] + 1, reason.words()));
        }
    }
    let kept: Vec<usize> = (0..distinct.len()).filter(|&n| rules.keep_foreign || reasons[n].is_none()).collect();
    let left: Vec<_> = kept.iter().map(|n| &sharpness[*n]).collect();
    (kept.iter().map(|n| distinct[*n]).collect(), logarithms(&left))
}

/// The frames without repetitions: a frame is left out if its samples equal those of an earlier frame.
fn without_repetitions(frames: &[Frame], rules: Rules, warnings: &mut Vec<String>) -> Vec<usize> {
    let mut distinct: Vec<usize> = Vec::new();
    for (n, frame) in frames.iter().enumerate() {
        let same = distinct.iter().find(|other| frames[**other].samples() == frame.samples());
        if let Some(other) = same {
            let action = if rules.stated { "positions are stated, and both are taken" } else { "it is left out" };
            warnings.push(format!("frame {} is the same photograph as frame {}; {action}", n + 1, other + 1));
        }
        if same.is_none() || rules.stated {
            distinct.push(n);
        }
    }
    distinct
}

/// The mean squared Laplacian at each place over the squared mean of the frame, for each octave.
type Sharpness = [Vec<f32>; OCTAVES];

/// What is compared of a frame.
struct Reduced {
    sharpness: Sharpness,
    coarse: Coarse,
}

impl Reduced {
    /// `None` for a frame that is too small.
    fn of(frame: &Frame) -> Option<Self> {
        let mut size = [frame.width() as usize, frame.height() as usize];
        let mut values = luminance(frame.intensities(Decode::None), frame.format().channels);
        while size[0].max(size[1]) > LONGEST {
            (values, size) = halved(&values, size);
        }
        if size[0].min(size[1]) < SHORTEST {
            return None;
        }
        let coarse = Coarse::of(&values, size);
        let bright = (values.iter().sum::<f32>() / values.len() as f32).max(f32::MIN_POSITIVE).powi(2);
        let sharpness = std::array::from_fn(|_| {
            let places = at_places(&values, size).into_iter().enumerate();
            let places = places.map(|(n, e)| if is_shown(frame, n) { e / bright } else { 0.0 }).collect();
            (values, size) = halved(&values, size);
            places
        });
        Some(Self { sharpness, coarse })
    }
}

/// Whether the middle of a place is part of the picture. Other places are filled, and never sharp.
fn is_shown(frame: &Frame, place: usize) -> bool {
    let middle = |at: usize, side: u32| (2 * at + 1) * side as usize / (2 * PLACES);
    let pixel = middle(place / PLACES, frame.height()) * frame.width() as usize + middle(place % PLACES, frame.width());
    frame.counted().is_none_or(|counted| counted[pixel] != 0)
}

/// The mean squared Laplacian of each place, without the border, where a part of the Laplacian is missing.
fn at_places(values: &[f32], size @ [width, height]: [usize; 2]) -> Vec<f32> {
    let squares = squared_laplacian(values, size);
    let mut sums = vec![(0.0f32, 0.0f32); PLACES * PLACES];
    for (y, x) in (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| (y, x))) {
        let place = &mut sums[y * PLACES / height * PLACES + x * PLACES / width];
        *place = (place.0 + squares[y * width + x], place.1 + 1.0);
    }
    sums.into_iter().map(|(sum, count)| sum / count.max(1.0)).collect()
}

/// The logarithm of sharpness by frame, octave and place, with the least 2 % of all positive values added as a floor.
fn logarithms(frames: &[&Sharpness]) -> Vec<Vec<f32>> {
    let floor = |octave: usize| {
        let all = frames.iter().flat_map(|frame| frame[octave].iter().copied());
        let mut all: Vec<f32> = all.filter(|e| *e > 0.0).collect();
        all.sort_by(f32::total_cmp);
        all.get(all.len() / 50).map_or(f32::MIN_POSITIVE, |e| e.max(f32::MIN_POSITIVE))
    };
    let floors: Vec<f32> = (0..OCTAVES).map(floor).collect();
    let of = |frame: &&Sharpness| {
        let octaves = frame.iter().zip(&floors);
        octaves.flat_map(|(values, floor)| values.iter().map(move |e| (e + floor).ln())).collect()
    };
    frames.iter().map(of).collect()
}

/// Whether fine detail changes against coarse detail between two frames: a measure that needs no registration.
fn differ_in_focus(logarithms: &[Vec<f32>]) -> bool {
    let ends = |frame: &Vec<f32>, place: usize| frame[place] - frame[place + (OCTAVES - 1) * PLACES * PLACES];
    let differ = |a: &Vec<f32>, b: &Vec<f32>| {
        let by_place = (0..PLACES * PLACES).map(|place| f64::from((ends(a, place) - ends(b, place)).abs()));
        median(by_place).is_some_and(|difference| difference > DIFFERENT)
    };
    (0..logarithms.len()).any(|n| logarithms[..n].iter().any(|other| differ(&logarithms[n], other)))
}

/// The violation of an order at each place, the mean over octaves: how much sharpness falls before the sharpest frame and
/// rises after it.
fn violation(logarithms: &[Vec<f32>], order: &[usize]) -> Vec<f64> {
    let mut places = vec![0.0; PLACES * PLACES];
    (0..OCTAVES * PLACES * PLACES).for_each(|feature| {
        let at = |n: usize| f64::from(logarithms[order[n]][feature]);
        let most = (0..order.len()).map(at).fold(f64::NEG_INFINITY, f64::max);
        let ends = at(0) + at(order.len() - 1);
        let changes: f64 = (1..order.len()).map(|n| (at(n) - at(n - 1)).abs()).sum();
        places[feature % (PLACES * PLACES)] += (0.5 * (changes + ends) - most) / OCTAVES as f64;
    });
    places
}

/// Returns the order that the frames show, and whether it is certain; the given one unless another is clearly better.
fn in_order(logarithms: &[Vec<f32>]) -> (Vec<usize>, bool) {
    let (given, best) = ((0..logarithms.len()).collect::<Vec<_>>(), best_order(logarithms));
    // By the violation alone: of a scene at one distance an order that never turns back changes less, and is as wrong.
    let [now, then] = [&given, &best].map(|order| violation(logarithms, order));
    let repaired: Vec<f64> = now.iter().zip(then).map(|(now, then)| now - then).collect();
    let changes: f64 = best.windows(2).map(|pair| distance(&logarithms[pair[0]], &logarithms[pair[1]])).sum();
    let is_significant = mean(&repaired) >= MIN_SIGNIFICANCE * standard_error(&repaired);
    let [certain, named] = MIN_REPAIRED.map(|share| is_significant && mean(&repaired) > share * changes);
    (if named { best } else { given }, certain)
}

/// The mean difference of sharpness over places and octaves.
fn distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.len() as f64
}

/// The order of the least mean [`violation`] and a share of the total change: the shortest closed tour through the frames and a node between the last and
/// the first, to which a sharp frame is far. Runs of frames are moved or reversed while that shortens the tour.
fn best_order(logarithms: &[Vec<f32>]) -> Vec<usize> {
    let ends = logarithms.len();
    let nothing = vec![0.0; logarithms.first().map_or(0, Vec::len)];
    let end = |a: &[f32]| 0.5 * a.iter().map(|a| f64::from(*a)).sum::<f64>() / a.len() as f64;
    let costs = workers::map(ends + 1, |n| {
        let own = logarithms.get(n).unwrap_or(&nothing);
        let to = |other: &Vec<f32>| if n == ends { end(other) } else { (0.5 + CHANGE) * distance(own, other) };
        logarithms.iter().map(to).chain([end(own)]).collect::<Vec<_>>()
    });
    let mut tour: Vec<usize> = [ends].into_iter().chain(0..ends).collect();
    let least = 1e-9 * costs.iter().flatten().map(|cost| cost.abs()).sum::<f64>() / (ends + 1) as f64;
    for _ in 0..MOST_MOVES {
        let Some(Move { first, last, after, reversed }) = best_move(&costs, &tour, least) else { break };
        let after = tour[after];
        let mut run: Vec<usize> = tour.drain(first..=last).collect();
        if reversed {
            run.reverse();
        }
        let at = tour.iter().position(|node| *node == after).map_or(0, |n| n + 1);
        tour.splice(at..at, run);
    }
    let mut order = tour.split_off(1);
    let rising = order.windows(2).filter(|pair| pair[0] < pair[1]).count();
    if 2 * rising < ends.saturating_sub(1) {
        order.reverse();
    }
    order
}

/// A run of a tour that is moved: its first and last place, the place after which it is inserted, and whether it is
/// reversed.
#[derive(Clone, Copy)]
struct Move {
    first: usize,
    last: usize,
    after: usize,
    reversed: bool,
}

/// The move that shortens a tour most, by more than `least`.
fn best_move(costs: &[Vec<f64>], tour: &[usize], least: f64) -> Option<Move> {
    let at = |n: usize| tour[n % tour.len()];
    let firsts = workers::map(tour.len() - 1, |n| {
        let first = n + 1;
        let mut best = (-least, None);
        for last in first..tour.len() {
            let [before, start, end, next] = [at(first - 1), at(first), at(last), at(last + 1)];
            let closed = costs[before][next] - costs[before][start] - costs[end][next];
            for after in (0..first).chain(last + 1..tour.len()) {
                let [a, b] = if after + 1 == first { [before, next] } else { [at(after), at(after + 1)] };
                for (reversed, [s, e]) in [(false, [start, end]), (true, [end, start])] {
                    let change = closed + costs[a][s] + costs[e][b] - costs[a][b];
                    if change < best.0 {
                        best = (change, Some(Move { first, last, after, reversed }));
                    }
                }
            }
        }
        best
    });
    firsts.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).and_then(|best| best.1)
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
    use crate::base::random::Random;
    use crate::base::{Channels, Samples};

    /// Frames of a slope that is in focus on the left in frame 0 and on the right in the last frame. The texture is
    /// waves of 6 px and more, blurred in closed form.
    fn slope(count: u32) -> Vec<Frame> {
        slope_between([0.0, f64::from(count - 1)], count)
    }

    /// The same, in focus between these frames.
    fn slope_between([left, right]: [f64; 2], count: u32) -> Vec<Frame> {
        let [width, height] = [192u32, 128];
        let frame = |n: u32| {
            let value = |i: u32| {
                let (x, y) = (f64::from(i % width), f64::from(i / width));
                let v = 2.0 * (f64::from(n) - left - x / f64::from(width) * (right - left)).powi(2) + 0.3;
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

    const STATED: Rules = Rules { stated: true, keep_foreign: false };

    fn judged(numbers: &[usize], rules: Rules) -> (Vec<usize>, Vec<String>) {
        let frames = slope(7);
        let given: Vec<Frame> = numbers.iter().map(|n| frames[*n].clone()).collect();
        let order = judge(&given, rules).unwrap();
        (order.frames.iter().map(|n| numbers[*n]).collect(), order.warnings)
    }

    #[test]
    fn frames_in_order_and_reversed_frames_keep_their_order() {
        for numbers in [[0, 1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1, 0]] {
            assert_eq!(judged(&numbers, Rules::default()), (numbers.to_vec(), Vec::new()));
        }
        // Nor does a part at one end of the range: most frames have nothing in focus.
        // Nor does a scene at one distance, which blurs alike before and behind it. Without noise, frames at equal
        // distances before and behind would be the same photograph: it lies between the steps.
        for focus in [[0.0, 1.6], [0.3, 0.6], [6.4, 8.0], [4.2, 4.2], [3.3, 3.3]] {
            let order = judge(&slope_between(focus, 9), Rules::default()).unwrap();
            assert_eq!((order.frames, order.warnings), ((0..9).collect(), Vec::new()));
        }
        // A missing frame does not break the order.
        assert_eq!(judged(&[0, 1, 2, 4, 5, 6], Rules::default()), (vec![0, 1, 2, 4, 5, 6], Vec::new()));
    }

    #[test]
    fn swapped_frames_are_put_in_order_unless_positions_are_stated() {
        for numbers in [
            [0, 1, 3, 2, 4, 5, 6],
            [0, 2, 3, 4, 1, 5, 6],
            [1, 0, 2, 3, 4, 5, 6],
            [4, 5, 6, 0, 1, 2, 3],
            [2, 1, 0, 3, 4, 5, 6],
            [6, 0, 1, 2, 3, 4, 5],
            [0, 4, 5, 6, 1, 2, 3],
        ] {
            let (order, warnings) = judged(&numbers, Rules::default());
            assert_eq!(order, [0, 1, 2, 3, 4, 5, 6], "{warnings:?}");
            assert!(warnings[0].contains("out of order, and are taken as"), "{warnings:?}");
            let (order, warnings) = judged(&numbers, STATED);
            assert!(order == numbers && warnings[0].contains("as given"), "{warnings:?}");
        }
    }

    #[test]
    fn a_repeated_frame_is_left_out_unless_positions_are_stated() {
        let (order, warnings) = judged(&[0, 1, 2, 2, 3, 4], Rules::default());
        assert_eq!((order, warnings.len()), (vec![0, 1, 2, 3, 4], 1));
        assert!(warnings[0].contains("frame 4 is the same photograph as frame 3"), "{warnings:?}");
        assert_eq!(judged(&[0, 1, 2, 2, 3, 4], STATED).0, [0, 1, 2, 2, 3, 4]);
    }

    fn uniform(count: usize, seed: u64) -> Vec<f64> {
        let mut random = Random::new(seed, 0);
        (0..count).map(|_| random.uniform()).collect()
    }

    /// A frame of the same size, of these values by pixel.
    fn replaced(like: &Frame, value: impl Fn(usize, usize) -> f64) -> Frame {
        let [width, height] = [like.width(), like.height()];
        let pixel = |i: usize| (value(i % width as usize, i / width as usize).clamp(0.0, 1.0) * 65535.0) as u16;
        let samples = Samples::U16((0..(width * height) as usize).map(pixel).collect());
        Frame::new(width, height, Channels::Gray, samples).unwrap()
    }

    #[test]
    fn a_foreign_frame_is_left_out_and_named_unless_it_is_to_be_kept() {
        let frames = slope(7);
        let value = |n: usize, x: usize, y: usize| f64::from(frames[n].intensities(Decode::None)[y * 192 + x]);
        let stack: Vec<_> = frames.iter().map(|frame| frame.intensities(Decode::None)).collect();
        let noise = uniform(192 * 128, 3);
        let middle = &frames[3];
        let mirrored = replaced(middle, |x, y| stack[3][y * 192 + 191 - x].into());
        let turned = replaced(middle, |x, y| stack[3][(127 - y) * 192 + 191 - x].into());
        let noisy = replaced(middle, |x, y| noise[y * 192 + x]);
        // The frame in focus at x is frame 6 x/192.
        let merged = replaced(middle, |x, y| value((6 * x + 96) / 192, x, y));
        for (foreign, words) in [
            (mirrored, "does not show the scene"),
            (turned, "does not show the scene"),
            (noisy, "does not show the scene"),
            (replaced(middle, |_, _| 1.0), "is blank"),
            (replaced(middle, |_, _| 0.0), "is blank"),
            (merged, "is sharp wherever any other frame is"),
        ] {
            for place in [0, 2, 3, 6] {
                let mut given = frames.clone();
                given[place] = foreign.clone();
                let order = judge(&given, Rules::default()).unwrap();
                let expected: Vec<usize> = (0..7).filter(|n| *n != place).collect();
                assert_eq!(order.frames, expected, "{words}: {:?}", order.warnings);
                let named = format!("frame {} {words}", place + 1);
                assert!(order.warnings[0].starts_with(&named) && order.warnings.len() == 1, "{:?}", order.warnings);
                let kept = judge(&given, Rules { stated: false, keep_foreign: true }).unwrap();
                assert!(
                    kept.frames.len() == 7 && kept.warnings[0].ends_with("it is kept as asked"),
                    "{:?}",
                    kept.warnings
                );
            }
        }
    }

    #[test]
    fn a_merged_frame_is_noticed_where_noise_outweighs_the_finest_texture() {
        let frames = slope(7);
        let stack: Vec<_> = frames.iter().map(|frame| frame.intensities(Decode::None)).collect();
        let noisy = |n: usize, value: &dyn Fn(usize, usize) -> f32| {
            let mut random = Random::new(n as u64, 1);
            let noise: Vec<f64> = (0..192 * 128).map(|_| 0.02 * random.normal()).collect();
            replaced(&frames[0], |x, y| f64::from(value(x, y)) + noise[y * 192 + x])
        };
        let mut given: Vec<Frame> = (0..7).map(|n| noisy(n, &|x, y| stack[n][y * 192 + x])).collect();
        assert_eq!(judge(&given, Rules::default()).unwrap().warnings, Vec::<String>::new());
        given[3] = noisy(7, &|x, y| stack[(6 * x + 96) / 192][y * 192 + x]);
        let order = judge(&given, Rules::default()).unwrap();
        assert_eq!(order.frames, [0, 1, 2, 4, 5, 6], "{:?}", order.warnings);
        assert!(order.warnings[0].starts_with("frame 4 is sharp wherever any other frame is"), "{:?}", order.warnings);
    }

    #[test]
    fn frames_of_several_scenes_are_refused() {
        let frames = slope(3);
        let other = |seed: u64| {
            let waves = uniform(64, seed);
            replaced(&frames[0], |x, y| {
                let wave =
                    |n: usize| ((0.05 + 0.6 * waves[n]) * (x as f64 * (7.0 * waves[n + 1]).cos() + y as f64)).sin();
                0.5 + 0.05 * (0..12).map(|n| wave(5 * n)).sum::<f64>()
            })
        };
        let error = judge(&[frames[0].clone(), other(1), other(2)], Rules::default()).err().unwrap();
        assert!(error.to_string().contains("only 1 of 3 frames differ and show one scene"), "{error}");
    }
}
