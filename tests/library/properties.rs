//! Metamorphic tests: a change of the photographs must change the solution in a known way.
//!
//! The changes are shift, mirror, padding, exchange, exposure, and more iterations. The tests use few seeds because a
//! solve takes long.

use crate::common::scene::{luminance, pair, slanted};
use crate::common::{TestEngine, trust};
use parfocal::{
    Frame, Settings, Solution,
    transform::{Similarity, centre},
};

const SIZE: [u32; 2] = [97, 75];
/// Width of the excluded border, px. The pixels beyond the image border differ between the solves.
const BORDER: usize = 12;

fn seeds() -> std::ops::Range<u64> {
    0..if trust::is_long() { 12 } else { 1 }
}

fn start(seed: u64) -> Similarity {
    let of = |n: u64| ((seed * 7 + n * 3) % 11) as f64 / 11.0 - 0.5;
    Similarity::new(1.6 * of(1), 1.6 * of(2), 0.4 * of(3), 1.0 + 0.01 * of(4))
}

fn scene(seed: u64) -> [Frame; 2] {
    pair(SIZE, start(seed), slanted(SIZE[0]), 0.0, 100 + seed)
}

fn solve([i1, i2]: &[Frame; 2]) -> Solution {
    TestEngine::new().solve([i1, i2], &Settings::default())
}

/// Returns a frame whose pixels are copied from the positions that `of` returns.
fn gather(frame: &Frame, [width, height]: [u32; 2], of: impl Fn(usize, usize) -> (usize, usize)) -> Frame {
    let (values, row) = (luminance(frame), frame.width() as usize);
    let at = |i: usize| of(i % width as usize, i / width as usize);
    let values = (0..(width * height) as usize).map(at).map(|(x, y)| values[y * row + x] as f32);
    Frame::gray(width, height, values.collect()).unwrap()
}

/// Returns the rms of V minus the expected V, px², inside the border. NaN pixels are excluded.
fn rms(solution: &Solution, expected: impl Fn(usize, usize) -> f32) -> f64 {
    let (width, height) = (solution.width as usize, solution.height as usize);
    let places = (BORDER..height - BORDER).flat_map(|y| (BORDER..width - BORDER).map(move |x| (x, y)));
    let errors: Vec<f64> = places
        .map(|(x, y)| f64::from(solution.relative_blur[y * width + x]) - f64::from(expected(x, y)))
        .filter(|error| !error.is_nan())
        .collect();
    assert!(errors.len() > width * height / 4, "only {} pixels", errors.len());
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

fn v(solution: &Solution) -> impl Fn(usize, usize) -> f32 {
    |x, y| solution.relative_blur[y * solution.width as usize + x]
}

/// Asserts for each seed that the error of V is at most `most_v` px² and the corner error of T at most `most_t` px.
#[track_caller]
fn hold(what: &str, [most_v, most_t]: [f64; 2], of: impl Fn(u64) -> [f64; 2]) {
    let found: Vec<[f64; 2]> = seeds().map(of).collect();
    let worst = [0, 1].map(|i| found.iter().map(|f| f[i]).fold(0.0, f64::max));
    let figure = format!("V {:.4} px² of {most_v}, T {:.4} px of {most_t}, {} pairs", worst[0], worst[1], found.len());
    trust::note(&format!("property: {what}"), figure);
    assert!(worst[0] <= most_v && worst[1] <= most_t, "{what}: {found:?}");
}

#[test]
fn shifting_i2_shifts_t_by_the_same_amount() {
    hold("shift", [0.02, 0.005], |seed| {
        let (t, by) = (start(seed), Similarity::new(1.25, -0.75, 0.0, 1.0));
        let moved = pair(SIZE, by.after(&t), slanted(SIZE[0]), 0.0, 100 + seed);
        let (plain, shifted) = (solve(&scene(seed)), solve(&moved));
        let expected = plain.transform.at_centre();
        let expected = by.after(&expected);
        [rms(&shifted, v(&plain)), shifted.transform.corner_distance(expected, SIZE[0], SIZE[1])]
    });
}

#[test]
fn a_mirrored_pair_has_mirrored_results() {
    hold("mirror", [0.01, 0.002], |seed| {
        let [width, _] = SIZE.map(|side| side as usize);
        let plain = solve(&scene(seed));
        let mirrored = solve(&scene(seed).each_ref().map(|frame| gather(frame, SIZE, |x, y| (width - 1 - x, y))));
        let [x, y] = plain.transform.translation();
        let expected = Similarity::new(-x, y, -plain.transform.rotation_deg(), plain.transform.scale());
        let t = mirrored.transform.corner_distance(expected, SIZE[0], SIZE[1]);
        [rms(&mirrored, |x, y| v(&plain)(width - 1 - x, y)), t]
    });
}

#[test]
fn padding_hardly_changes_the_interior() {
    const AROUND: usize = 8;
    hold("padding", [0.3, 0.1], |seed| {
        let size = SIZE.map(|side| side + 2 * AROUND as u32);
        let clamp = |p: usize, side: u32| p.saturating_sub(AROUND).min(side as usize - 1);
        let around = scene(seed).each_ref().map(|f| gather(f, size, |x, y| (clamp(x, SIZE[0]), clamp(y, SIZE[1]))));
        let (plain, padded) = (solve(&scene(seed)), solve(&around));
        let within = |x: usize, y: usize| v(&padded)(x + AROUND, y + AROUND);
        // Both transforms are about the same centre.
        [rms(&plain, within), padded.transform.corner_distance(plain.transform, SIZE[0], SIZE[1])]
    });
}

#[test]
fn an_exchanged_pair_has_the_inverse_t_and_the_opposite_v() {
    hold("exchange", [0.1, 0.01], |seed| {
        let [i1, i2] = scene(seed);
        let (plain, exchanged) = (solve(&[i1.clone(), i2.clone()]), solve(&[i2, i1]));
        let c = centre(SIZE[0], SIZE[1]);
        let opposite = |x: usize, y: usize| {
            let [x, y] = plain.transform.apply([x as f64, y as f64], c).map(|p| p.round().max(0.0) as usize);
            -v(&exchanged)(x.min(SIZE[0] as usize - 1), y.min(SIZE[1] as usize - 1))
        };
        let t = exchanged.transform.corner_distance(plain.transform.inverse(), SIZE[0], SIZE[1]);
        [rms(&plain, opposite), t]
    });
}

#[test]
fn another_exposure_of_i2_changes_only_the_gain() {
    hold("exposure", [0.01, 0.002], |seed| {
        let [i1, i2] = scene(seed);
        let values = luminance(&i2).iter().map(|value| (0.8 * value + 0.05) as f32).collect();
        let darker = Frame::gray(SIZE[0], SIZE[1], values).unwrap();
        let (plain, exposed) = (solve(&[i1.clone(), i2]), solve(&[i1, darker]));
        let gain = exposed.photometric.gain * 0.8 / plain.photometric.gain;
        assert!((gain - 1.0).abs() < 2e-3, "seed {seed}: the gain is off by a factor of {gain}");
        let t = exposed.transform.corner_distance(plain.transform, SIZE[0], SIZE[1]);
        [rms(&exposed, v(&plain)), t]
    });
}

#[test]
fn more_iterations_do_not_change_a_settled_solution() {
    hold("more iterations", [0.01, 0.001], |seed| {
        let [i1, i2] = scene(seed);
        let longer = Settings { outer_iterations: 300, ..Settings::default() };
        let (plain, longer) = (solve(&[i1.clone(), i2.clone()]), TestEngine::new().solve([&i1, &i2], &longer));
        let last = |solution: &Solution| *solution.levels.last().unwrap().energy.last().unwrap();
        assert!(last(&longer) <= last(&plain) * 1.001, "seed {seed}: {} and {}", last(&longer), last(&plain));
        [rms(&longer, v(&plain)), longer.transform.corner_distance(plain.transform, SIZE[0], SIZE[1])]
    });
}
