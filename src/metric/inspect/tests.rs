//! Parts in closed form: a golden relief, a part of it that is shifted and tilted, with and without a bump.

use super::*;
use crate::base::random::Random;
use crate::base::statistics::tests::smooth_noise;
use crate::base::{Similarity, centre};

const SIZE: [u32; 2] = [120, 90];

/// Of a good part at a place.
fn relief([x, y]: [f64; 2]) -> f64 {
    5.0 + 1.5 * (0.11 * x).sin() * (0.13 * y).cos()
}

fn heights(of: impl Fn(f64, f64) -> f64, sigma: f64) -> Heights {
    let width = SIZE[0] as usize;
    let pixels = width * SIZE[1] as usize;
    let values: Vec<f32> = (0..pixels).map(|i| of((i % width) as f64, (i / width) as f64) as f32).collect();
    Heights::new(SIZE, &values, &vec![sigma as f32; pixels]).unwrap()
}

fn good(sigma: f64) -> Heights {
    heights(|x, y| relief([x, y]), sigma)
}

/// Where the golden part's pixels are in the part's picture.
fn shift() -> Similarity {
    Similarity::new(3.4, -2.7, 2.0, 1.01)
}

/// The part on the golden one's pixels: tilted, and with what is added to it there.
fn part(added: impl Fn(f64, f64) -> f64, sigma: f64) -> Heights {
    let (t, middle) = (shift(), centre(SIZE[0], SIZE[1]));
    let at = |x: f64, y: f64| {
        let place = t.inverse().apply([x, y], middle);
        relief(place) + added(place[0], place[1]) + 0.7 + 0.02 * x - 0.015 * y
    };
    heights(at, sigma).onto(SIZE, &t)
}

fn disk(x: f64, y: f64, [cx, cy]: [f64; 2], radius: f64) -> bool {
    (x - cx).hypot(y - cy) < radius
}

#[test]
fn tilt_and_shift_alone_pass() {
    let found = inspect(&part(|_, _| 0.0, 0.01), &good(0.01), &Limits::new(0.1)).unwrap();
    assert!(found.is_go(&Limits::new(0.1)), "{:?}", found.regions);
    let most = found.difference.iter().filter(|off| off.is_finite()).fold(0.0f32, |a, b| a.max(b.abs()));
    assert!(most < 0.02, "bilinear in the relief: {most}");
    // What left the picture.
    let share = found.unjudged_share();
    assert!(share > 0.02 && share < 0.15, "{share}");
    // The tilt in the part's pixels, turned by 2° and scaled.
    let [a, b] = found.plane.slope;
    assert!((a.hypot(b) - 1.01 * 0.02f64.hypot(0.015)).abs() < 1e-3, "{:?}", found.plane);
}

#[test]
fn a_bump_and_a_pit_are_found_where_they_are() {
    let (bump, pit) = ([40.0, 30.0], [85.0, 60.0]);
    let added = |x: f64, y: f64| match () {
        () if disk(x, y, bump, 8.0) => 1.0,
        () if disk(x, y, pit, 5.0) => -0.6,
        () => 0.0,
    };
    let limits = Limits::new(0.3);
    let found = inspect(&part(added, 0.01), &good(0.01), &limits).unwrap();
    assert!(!found.is_go(&limits) && found.regions.len() == 2, "{:?}", found.regions);
    for (region, place, radius, height) in [(found.regions[0], bump, 8.0, 1.0), (found.regions[1], pit, 5.0, -0.6)] {
        let area = std::f64::consts::PI * radius * radius;
        // Half a pixel of the rim to either side.
        assert!((region.area_px as f64 - area).abs() < std::f64::consts::PI * radius, "{region:?}");
        let [x, y] = region.centroid_px;
        // Its rim lies between pixels, of which either may be in.
        assert!((x - place[0]).hypot(y - place[1]) < 0.5, "{region:?}");
        // Its rim is interpolated: lower, but for the extreme.
        assert!((region.extreme - height).abs() < 0.03 && (region.mean / height - 0.95).abs() < 0.06, "{region:?}");
        let bounds = region.bounds_px;
        assert!(bounds.width.abs_diff(2 * radius as u32) <= 2, "{bounds:?}");
        assert!((f64::from(bounds.x) + radius - place[0]).abs() < 1.6, "{bounds:?}");
    }
    let within = found.labels[30 * 120 + 40];
    assert_eq!((within, found.labels[60 * 120 + 85], found.labels[0]), (1, 2, 0));
    let wide = Limits { min_area_px: 100, ..limits };
    assert_eq!(inspect(&part(added, 0.01), &good(0.01), &wide).unwrap().regions.len(), 1);
    assert!(inspect(&part(added, 0.01), &good(0.01), &Limits::new(1.2)).unwrap().regions.is_empty());
    assert!(inspect(&part(added, 0.3), &good(0.3), &limits).unwrap().regions.is_empty(), "within three deviations");
}

#[test]
fn noise_at_its_stated_deviation_gives_no_region() {
    let (sigma, limits) = (0.2, Limits::new(0.0));
    for seed in 0..4 {
        let noise = [2 * seed, 2 * seed + 1].map(|seed| smooth_noise([120, 90], 2.0, seed));
        let [part, golden] =
            noise.map(|noise| heights(|x, y| relief([x, y]) + sigma * noise[y as usize * 120 + x as usize], sigma));
        let found = inspect(&part, &golden, &limits).unwrap();
        assert!(found.is_go(&limits), "{:?}", found.regions);
    }
}

#[test]
fn holes_are_not_judged_and_too_many_fail() {
    let nan = f64::NAN;
    let hole = |x: f64, y: f64| if x < 40.0 && y < 45.0 { nan } else { relief([x, y]) };
    // Where the golden part has none, nothing is missing.
    let found = inspect(&good(0.1), &heights(hole, 0.1), &Limits::new(0.1)).unwrap();
    assert_eq!((found.unjudged, found.judged), (0, 120 * 90 - 40 * 45));
    let limits = Limits::new(0.1);
    let found = inspect(&heights(hole, 0.1), &good(0.1), &limits).unwrap();
    assert_eq!((found.unjudged, found.regions.len()), (40 * 45, 0));
    assert!(found.difference[0].is_nan() && found.is_go(&limits));
    assert!(!found.is_go(&Limits { max_unjudged: 0.16, ..limits }), "a sixth, {}", found.unjudged_share());
    let none = heights(|_, _| nan, 0.1);
    assert!(inspect(&none, &good(0.1), &limits).unwrap_err().to_string().contains("too few pixels"));
}

#[test]
fn golden_parts_allow_what_they_differ_by() {
    // Good parts differ by 0.3 from one another at the left, each lies otherwise, and two of eight have a hole.
    let mut random = Random::new(7, 0);
    let mut one = |n: usize| {
        let bow = 0.3 * random.normal();
        heights(
            move |x, y| match () {
                () if n < 2 && disk(x, y, [90.0, 20.0], 6.0) => f64::NAN,
                () => relief([x, y]) + 0.4 * n as f64 + 0.01 * x + if x < 25.0 { bow } else { 0.0 },
            },
            0.02,
        )
    };
    let parts: Vec<Heights> = (0..8).map(&mut one).collect();
    let golden = golden(&parts).unwrap();
    assert!(golden.values.iter().all(|v| v.is_finite()), "six of eight have it");
    let at = |x: usize| f64::from(golden.deviation[45 * 120 + x]);
    assert!(at(12) > 0.15 && at(12) < 0.6, "{}", at(12));
    // σ / √8, the plane's own error aside.
    assert!((at(80) - 0.02 / 8f64.sqrt()).abs() < 2e-3, "{}", at(80));
    let of = |left: f64, right: f64| {
        let added = |x: f64| match () {
            () if x < 12.0 => left,
            () if x > 105.0 => right,
            () => 0.0,
        };
        let part = heights(|x, y| relief([x, y]) + added(x), 0.02);
        inspect(&part, &golden, &Limits::new(0.1)).unwrap().regions.len()
    };
    assert_eq!((of(0.3, 0.0), of(0.0, 0.3)), (0, 1));
}
