//! Comparison with the packages surfalize 0.19.2 and SurfaceTopography 1.27.1 of PyPI, on surfaces that
//! `tools/peers/roughness.py` generates too.

use std::f64::consts::{PI, TAU};

use super::areal::Surface;
use super::areal::tests::surface;
use super::profile::ProfileParameters;
use super::{Filters, Form, PARAMETERS};
use crate::base::random::Random;

const SIZE: [usize; 2] = [200, 160];

/// No value.
const NAN: f64 = f64::NAN;

/// The values that `tools/peers/roughness.py` prints, in the order of [`PARAMETERS`].
#[rustfmt::skip]
const SURFALIZE: [(&str, [f64; 14]); 6] = [
    ("sine and tilt, plane", [
        1.26263432, 1.40755159, 0.00250676855, 1.53367392, 2.18959997, 2.18722517, 4.37682514,
        0.353623344, 5.98579123, 5.52552553, NAN, 1.26263432, 1.40755159, 4.02060456,
    ]),
    ("isotropic waves, quadric", [
        0.792067681, 0.999112679, 0.0645250911, 3.03179703, 3.64949102, 3.08169102, 6.73118204,
        0.301147977, 4.35114149, 7.42470183, 0.869747742, 0.789922637, 0.97876529, 2.82712689,
    ]),
    ("lay, no form", [
        0.859141612, 1.07713889, -0.0649129174, 3.07079793, 3.60261003, 4.22036111, 7.82297114,
        0.469270212, 9.74714227, 3.35535536, 0.104045153, 0.857428637, 1.05760831, 3.88701072,
    ]),
    ("peaks and noise, S 6 px, L 50 px", [
        0.652615723, 0.83868054, 0.384079083, 3.502061, 3.12970268, 2.50176038, 5.63146306,
        0.219405557, 2.33250021, 8.28490692, 0.753798309, 0.630849639, 0.794802282, 1.57734086,
    ]),
    ("waves on a cylinder, cylinder", [
        0.8706129, 1.11540675, 0.100231146, 3.30400737, 4.36971124, 3.79585836, 8.16556961,
        0.354441518, 5.94141387, 6.68416513, 0.920270254, 0.838519653, 1.05889592, 3.17946147,
    ]),
    ("missing pixels, plane", [
        0.794634696, 1.00584873, 0.0992352407, 3.04927953, 3.61593294, 3.08645939, 6.70239233,
        NAN, NAN, NAN, NAN, NAN, NAN, NAN,
    ]),
];

/// Sq, Sz and Sdq of SurfaceTopography, as the same script prints them.
const SURFACE_TOPOGRAPHY: [(&str, [f64; 3]); 5] = [
    ("sine and tilt, plane", [1.40755159, 4.37682514, 0.353623344]),
    ("isotropic waves, quadric", [0.999112679, 6.73118204, 0.300912192]),
    ("lay, no form", [1.07713889, 7.82297114, 0.469788973]),
    ("peaks and noise, plane", [1.03609092, 7.85790296, 0.276342653]),
    ("missing pixels, plane", [1.00584873, 6.70239233, 0.303048857]),
];

/// The largest difference of its Sdq, as a share: it averages over pixels with a difference along both axes, here each
/// axis is averaged over its own.
const BOTH_AXES: f64 = 3e-3;

/// The largest difference of each parameter, as a share, where definitions agree: that of 9 printed digits.
const PRINTED: f64 = 2e-8;
/// The difference of Sal and Str: surfalize interpolates the autocorrelation by a spline, and takes the nearest of 1000 points on
/// a ray.
const INTERPOLATED: f64 = 3e-3;
/// The difference with Gaussian filters: surfalize ends the weights at 0.75 cutoffs, here they end at one.
const TRUNCATED: f64 = 2e-4;
/// That on a cylinder: surfalize minimizes the distances from it, here heights above it.
const RADIAL: f64 = 2e-3;

fn waves(seed: u64, count: usize, [shortest, longest]: [f64; 2], spread: f64) -> Surface {
    let mut random = Random::new(seed, 0);
    let all: Vec<[f64; 3]> = (0..count)
        .map(|_| {
            let wavelength = shortest + (longest - shortest) * random.uniform();
            let angle = PI * spread * (random.uniform() - 0.5);
            let (k, phase) = (TAU / wavelength, TAU * random.uniform());
            [k * angle.cos(), k * angle.sin(), phase]
        })
        .collect();
    surface(SIZE, |x, y| all.iter().map(|[u, v, phase]| 0.2 * (u * x + v * y + phase).cos()).sum())
}

fn bumps(seed: u64) -> Surface {
    let mut random = Random::new(seed, 0);
    let mut made = waves(seed + 1, 40, [15.0, 60.0], 1.0);
    let all: Vec<[f64; 3]> =
        (0..60).map(|_| [200.0 * random.uniform(), 160.0 * random.uniform(), 1.0 + 2.0 * random.uniform()]).collect();
    for (i, z) in made.values.iter_mut().enumerate() {
        let [x, y] = [(i % 200) as f64, (i / 200) as f64];
        *z += all.iter().map(|[u, v, peak]| peak * (-((x - u).powi(2) + (y - v).powi(2)) / 18.0).exp()).sum::<f64>();
        *z += 0.2 * (random.uniform() - 0.5);
    }
    made
}

fn plus(mut of: Surface, form: impl Fn(f64, f64) -> f64) -> Surface {
    of.values.iter_mut().enumerate().for_each(|(i, z)| *z += form((i % 200) as f64, (i / 200) as f64));
    of
}

fn without(mut of: Surface, form: Form) -> Surface {
    of.subtract_form(form, Some(1.0)).unwrap();
    of
}

/// The part without a border of 50 px.
fn inner(of: &Surface) -> Surface {
    let rows = of.values.chunks_exact(200).skip(50).take(60);
    Surface { width: 100, values: rows.flat_map(|row| &row[50..150]).copied().collect() }
}

fn surfaces() -> Vec<Surface> {
    let sine = surface(SIZE, |x, y| 2.0 * (TAU * x / 25.0).sin() + 0.05 * x - 0.02 * y);
    let quadric = |x: f64, y: f64| {
        let (x, y) = (x - 80.0, y - 50.0);
        0.0005 * x * x - 0.0003 * x * y + 0.0008 * y * y
    };
    let cylinder = |x: f64, y: f64| {
        let ((s, c), (x, y)) = (0.3f64.sin_cos(), (x - 90.0, y));
        let d = c * (y - 75.0) - s * x;
        (900.0f64.powi(2) - d * d).sqrt() + 0.02 * (c * x + s * (y - 75.0))
    };
    let filters = Filters::new(Some(6.0), Some(50.0));
    let mut missing = waves(1, 60, [10.0, 40.0], 1.0);
    for (i, z) in missing.values.iter_mut().enumerate() {
        if (i % 200) % 20 < 7 && (i / 200) % 16 < 6 {
            *z = NAN;
        }
    }
    vec![
        without(sine, Form::Plane),
        without(plus(waves(1, 60, [10.0, 40.0], 1.0), quadric), Form::Quadric),
        waves(2, 60, [8.0, 30.0], 0.15),
        inner(&filters.apply(without(bumps(5), Form::Plane))),
        without(plus(waves(3, 60, [10.0, 40.0], 1.0), cylinder), Form::Cylinder),
        without(missing, Form::Plane),
    ]
}

fn parameters(of: &Surface) -> [f64; 14] {
    let (h, spatial) = (of.height_parameters(), of.spatial_parameters());
    let rows = ProfileParameters::of_rows(of, &Filters::default());
    let texture = if spatial.is_bound { NAN } else { spatial.str };
    let [sdq, sdr] = [of.sdq(1.0), of.sdr(1.0)];
    [h.sa, h.sq, h.ssk, h.sku, h.sp, h.sv, h.sz, sdq, sdr, spatial.sal, texture, rows.ra, rows.rq, rows.rz]
}

#[test]
fn parameters_agree_with_surfalize() {
    for ((name, expected), surface) in SURFALIZE.iter().zip(surfaces()) {
        let found = parameters(&surface);
        let tolerance = if name.contains("S 6") {
            TRUNCATED
        } else if name.contains("cylinder") {
            RADIAL
        } else {
            PRINTED
        };
        println!("{name}");
        for (n, (symbol, _)) in PARAMETERS.iter().enumerate() {
            let (found, expected) = (found[n], expected[n]);
            let share = found / expected - 1.0;
            println!("  {symbol:<4} {found:>12.6} {expected:>12.6} {share:>10.1e}");
            let tolerance = match *symbol {
                "Sal" | "Str" => tolerance.max(INTERPOLATED),
                // Means of both signs, near zero.
                "Ssk" => 20.0 * tolerance,
                _ => tolerance,
            };
            // What surfalize does not determine is not compared.
            assert!(expected.is_nan() || share.abs() <= tolerance, "{name}: {symbol} is {found}, not {expected}");
        }
    }
}

#[test]
fn parameters_agree_with_surface_topography() {
    let all = surfaces();
    let own = [all[0].clone(), all[1].clone(), all[2].clone(), without(bumps(5), Form::Plane), all[5].clone()];
    for ((name, [sq, sz, sdq]), surface) in SURFACE_TOPOGRAPHY.iter().zip(own) {
        let heights = surface.height_parameters();
        let found = [heights.sq / sq - 1.0, heights.sz / sz - 1.0, surface.sdq(1.0) / sdq - 1.0];
        println!("{name}: Sq {:.1e}, Sz {:.1e}, Sdq {:.1e}", found[0], found[1], found[2]);
        assert!(found[..2].iter().all(|share| share.abs() <= PRINTED), "{name}: {found:?}");
        assert!(found[2].abs() <= BOTH_AXES, "{name}: {found:?}");
    }
}
