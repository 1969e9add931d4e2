//! How often the intervals of repeated measurements hold the truth. `docs/evaluation.md` has the table.

use parfocal::Region;
use parfocal::metric::Estimate;
use parfocal::metric::inspect::Heights;
use parfocal::metric::repeat::{Interval, Repeatability, RepeatedMaps, Study, TypeOne, repeated_maps};
use parfocal::metric::roughness::{Area, Form};

/// Seeded Gaussian numbers.
struct Random(u64);

impl Random {
    /// SplitMix64.
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (((z ^ (z >> 31)) >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Box and Muller.
    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Sets of repeats, and studies, of each row.
const SETS: usize = 400;
const SIZE: [usize; 2] = [128, 96];
/// Noise of a map, the unit of all heights.
const NOISE: f64 = 0.05;

/// The number of intervals of a row that hold the truth.
#[derive(Default)]
struct Row {
    inside: usize,
    all: usize,
}

impl Row {
    fn add(&mut self, truth: f64, [low, high]: [f64; 2]) {
        self.inside += usize::from((low..=high).contains(&truth));
        self.all += 1;
    }

    fn percent(&self) -> f64 {
        100.0 * self.inside as f64 / self.all as f64
    }
}

fn two_errors(of: Estimate) -> [f64; 2] {
    [of.value - 2.0 * of.standard_error, of.value + 2.0 * of.standard_error]
}

fn ends(of: Interval) -> [f64; 2] {
    [of.low, of.high]
}

/// Noise of deviation 1, averaged over a Gaussian window of this deviation, px.
fn noise(window: f64, random: &mut Random) -> Vec<f64> {
    let reach = (3.0 * window).ceil() as usize;
    let weight = |i: usize| (-0.5 * ((i as f64 - reach as f64) / window.max(1e-9)).powi(2)).exp();
    let weights: Vec<f64> = (0..=2 * reach).map(weight).collect();
    let gain = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
    let (wide, high) = (SIZE[0] + 2 * reach, SIZE[1] + 2 * reach);
    let white: Vec<f64> = (0..wide * high).map(|_| random.normal()).collect();
    let along = |from: &dyn Fn(usize) -> f64| weights.iter().enumerate().map(|(i, w)| w * from(i)).sum::<f64>();
    let rows: Vec<f64> = (0..SIZE[0] * high).map(|n| along(&|i| white[n / SIZE[0] * wide + n % SIZE[0] + i])).collect();
    (0..SIZE[0] * SIZE[1]).map(|n| gain * along(&|i| rows[n + i * SIZE[0]])).collect()
}

/// Maps of one part with noise, which they state rightly: from half of the mean on the left to one and a half on the
/// right.
fn maps(count: usize, window: f64, random: &mut Random) -> Vec<Heights> {
    let sigma = |n: usize| NOISE * (0.5 + (n % SIZE[0]) as f64 / (SIZE[0] - 1) as f64);
    let map = |_| {
        let noise = noise(window, random);
        let height = |n: usize| ((n % SIZE[0]) as f64 / 9.0).sin() + (n / SIZE[0]) as f64 / 30.0 + sigma(n) * noise[n];
        let values: Vec<f32> = (0..noise.len()).map(|n| height(n) as f32).collect();
        let stated: Vec<f32> = (0..noise.len()).map(|n| sigma(n) as f32).collect();
        Heights::new(SIZE.map(|side| side as u32), &values, &stated).unwrap()
    };
    (0..count).map(map).collect()
}

fn compared(maps: &[Heights]) -> RepeatedMaps {
    let region = Region { x: 0, y: 0, width: SIZE[0] as u32, height: SIZE[1] as u32 };
    repeated_maps(maps, &Area { region, mask: None }, Form::None).unwrap()
}

/// The number of sets in which the interval holds the truth: within 2 standard errors, or the interval of 95 %.
#[test]
#[ignore = "prints a table for docs/evaluation.md; some minutes"]
fn intervals_of_repeated_measurements_hold_the_truth() {
    let mut random = Random(25_178);
    let mut rows: Vec<(String, Row)> = Vec::new();
    // The root of the mean of the squares of the stated deviations.
    let squares = (0..SIZE[0]).map(|x| (0.5 + x as f64 / (SIZE[0] - 1) as f64).powi(2)).sum::<f64>();
    let truth = NOISE * (squares / SIZE[0] as f64).sqrt();
    for (window, count) in [(0.0, 2), (1.0, 2), (1.0, 3), (1.0, 10), (4.0, 2), (4.0, 10)] {
        let mut found: [Row; 4] = Default::default();
        for _ in 0..SETS {
            let of = compared(&maps(count, window, &mut random));
            found[0].add(truth, two_errors(of.noise));
            found[1].add(1.0, two_errors(of.seen_over_stated));
            found[2].add(0.6827, two_errors(of.within[0]));
            found[3].add(0.9545, two_errors(of.within[1]));
        }
        let names = ["noise", "seen over stated", "share within 1", "share within 2"];
        let set = format!("{count} maps, window {window} px");
        rows.extend(names.iter().zip(found).map(|(name, row)| (format!("{name} | {set}"), row)));
    }
    for count in [3, 10, 25] {
        let mut found: [Row; 4] = Default::default();
        let tolerance = 12.0;
        for _ in 0..SETS {
            let readings: Vec<f64> = (0..count).map(|_| 0.3 + random.normal()).collect();
            let of = Repeatability::of(&readings).unwrap();
            let study = TypeOne::new(&of, 0.0, tolerance);
            found[0].add(1.0, ends(of.standard_deviation));
            found[1].add(0.3, ends(study.bias));
            found[2].add(0.2 * tolerance / 6.0, ends(study.cg.unwrap()));
            found[3].add((0.1 * tolerance - 0.3) / 3.0, ends(study.cgk.unwrap()));
        }
        let names = ["standard deviation", "bias", "Cg", "Cgk"];
        rows.extend(names.iter().zip(found).map(|(name, row)| (format!("{name} | {count} readings"), row)));
    }
    for ([operators, parts, trials], interaction) in [([3, 10, 3], 0.0), ([3, 10, 3], 0.4), ([2, 5, 2], 0.0)] {
        let mut found: [Row; 6] = Default::default();
        let [of_operator, of_part, of_error]: [f64; 3] = [0.5, 2.0, 0.4];
        let gauge = (of_operator.powi(2) + interaction * interaction + of_error.powi(2)).sqrt();
        for _ in 0..SETS {
            let mut effects = |count, sigma: f64| (0..count).map(|_| sigma * random.normal()).collect::<Vec<f64>>();
            let (by_operator, by_part) = (effects(operators, of_operator), effects(parts, of_part));
            let (by_both, errors) =
                (effects(operators * parts, interaction), effects(operators * parts * trials, of_error));
            let reading = |(n, error): (usize, &f64)| {
                let cell = n / trials;
                by_operator[cell / parts] + by_part[cell % parts] + by_both[cell] + error
            };
            let readings = errors.iter().enumerate().map(reading).collect();
            let of = Study { operators, parts, trials, readings }.analyse(None).unwrap();
            let deviation = |n: usize| ends(of.components[n].standard_deviation.unwrap());
            found[0].add(of_error, deviation(0));
            found[1].add(of_operator, deviation(1));
            found[2].add(gauge, deviation(4));
            found[3].add(of_part, deviation(5));
            found[4].add(100.0 * gauge / gauge.hypot(of_part), ends(of.components[4].study_percent.unwrap()));
            found[5].add(1.41 * of_part / gauge, ends(of.categories.unwrap()));
        }
        let names = ["repeatability", "operator", "R&R", "part", "% study variation of R&R", "categories"];
        let with = if interaction > 0.0 { "with" } else { "no" };
        let set = format!("{operators} x {parts} x {trials}, {with} interaction");
        rows.extend(names.iter().zip(found).map(|(name, row)| (format!("{name} | {set}"), row)));
    }
    println!("| interval | of | truth inside |\n| --- | --- | --- |");
    rows.iter().for_each(|(name, row)| println!("| {name} | {:.1} % |", row.percent()));
    let least = rows.iter().map(|(_, row)| row.percent()).fold(100.0, f64::min);
    assert!(least > 84.0, "{least}");
}
