//! Synthetic relative blur of known lenses.

use super::*;
use crate::base::statistics::tests::smooth_noise;

const SIZE: [usize; 2] = [160, 120];

fn cup() -> Lens {
    let (pixel_pitch, focus) = (0.01304, [529.0, 869.0]);
    Lens { focal_length: 25.0, f_number: 8.3, pixel_pitch, focus, kappa: 0.43, telecentric: true }
}

fn macro_lens() -> Lens {
    let (pixel_pitch, focus) = (0.0075, [226.5, 233.5]);
    Lens { focal_length: 50.0, f_number: 5.6, pixel_pitch, focus, kappa: 0.43, telecentric: false }
}

fn plane(lens: &Lens) -> Target {
    let [near, far] = lens.focus;
    Target::Plane([near, 0.3 * near + 0.7 * far, 0.8 * near + 0.2 * far])
}

/// V of a target by its lens, with noise alike over a few pixels.
fn measured(lens: &Lens, scale: f64, target: &Target, noise: f64, seed: u64) -> Vec<f32> {
    let blank = vec![0.0; SIZE[0] * SIZE[1]];
    let depths = target.depths(lens, &Values { width: SIZE[0] as u32, values: &blank }).unwrap();
    let noise: Vec<f64> = smooth_noise(SIZE, 1.5, seed).into_iter().map(|n| noise * n).collect();
    depths.iter().zip(noise).map(|(&z, n)| (lens.relative_blur(z, scale) + n) as f32).collect()
}

fn found(start: &Lens, scale: f64, blur: &[f32], target: &Target, unknowns: &[LensParameter]) -> Calibration {
    let field = Values { width: SIZE[0] as u32, values: blur };
    let calibration = calibrate(start, scale, &field, &vec![0.05; blur.len()], target, unknowns).unwrap();
    println!("{calibration:?}");
    calibration
}

const TWO: [LensParameter; 2] = [LensParameter::Kappa, LensParameter::Focus2];

#[test]
fn a_tilted_plane_gives_kappa_and_a_focus_distance() {
    for truth in [cup(), macro_lens()] {
        let (s, target) = (truth.breathing(), plane(&truth));
        let blur = measured(&truth, s, &target, 0.0, 0);
        let between = truth.focus[1] - truth.focus[0];
        let start = Lens { kappa: 0.7, focus: [truth.focus[0], truth.focus[1] + 0.2 * between], ..truth };
        let exact = found(&start, s, &blur, &target, &TWO);
        assert!((exact.lens.kappa / 0.43 - 1.0).abs() < 1e-4, "{exact:?}");
        assert!((exact.lens.focus[1] - truth.focus[1]).abs() < 1e-3 * between, "{exact:?}");
        assert!(exact.undetermined.is_empty() && exact.lens.focus[0] == truth.focus[0]);
    }
}

#[test]
fn standard_errors_are_the_scatter_over_repeated_noise() {
    let (truth, target) = (cup(), plane(&cup()));
    let start = Lens { kappa: 0.5, ..truth };
    let trials: Vec<[Estimate; 2]> = (0..16)
        .map(|seed| {
            let blur = measured(&truth, 1.0, &target, 0.05, seed);
            [0, 1].map(|i| found(&start, 1.0, &blur, &target, &TWO).found[i].estimate)
        })
        .collect();
    for (i, value) in [(0, truth.kappa), (1, truth.focus[1])] {
        let mean_square = |f: &dyn Fn(&Estimate) -> f64| trials.iter().map(|t| f(&t[i]).powi(2)).sum::<f64>() / 16.0;
        let (scatter, claimed) = (mean_square(&|e| e.value - value).sqrt(), mean_square(&|e| e.standard_error).sqrt());
        println!("scatter {scatter}, claimed {claimed}");
        assert!((0.6..1.7).contains(&(claimed / scatter)), "unknown {i}: {claimed}, and the scatter is {scatter}");
    }
}

#[test]
fn what_a_target_cannot_tell_is_said_and_left_as_stated() {
    let (truth, region) = (cup(), |x| Region { x, y: 10, width: 50, height: 90 });
    let start = Lens { kappa: 0.5, ..truth };
    // V over x is a line: two numbers.
    let blur = measured(&truth, 1.0, &plane(&truth), 0.02, 1);
    let three = found(
        &start,
        1.0,
        &blur,
        &plane(&truth),
        &[LensParameter::Kappa, LensParameter::Focus1, LensParameter::Focus2],
    );
    assert_eq!((&three.undetermined[..], three.lens.focus[1]), (&[LensParameter::Focus2][..], 869.0));
    // One depth: one number.
    let one = Target::Steps(vec![(region(0), 560.0)]);
    let single = found(&start, 1.0, &measured(&truth, 1.0, &one, 0.02, 2), &one, &TWO);
    assert_eq!((&single.undetermined[..], single.lens.focus[1]), (&[LensParameter::Focus2][..], 869.0));
    assert!((single.lens.kappa - 0.43).abs() < 0.01, "{single:?}");
    // Two depths: two.
    let two = Target::Steps(vec![(region(0), 560.0), (region(80), 800.0)]);
    let both = found(&start, 1.0, &measured(&truth, 1.0, &two, 0.02, 3), &two, &TWO);
    assert!(both.undetermined.is_empty() && (both.lens.focus[1] - 869.0).abs() < 20.0, "{both:?}");
    // Where both images are equally blurred, V is 0 whatever κ is.
    let z = truth.depth(0.0, 1.0).unwrap();
    let none = Target::Steps(vec![(region(0), z)]);
    let blur = measured(&truth, 1.0, &none, 0.02, 4);
    let field = Values { width: SIZE[0] as u32, values: &blur };
    let result = calibrate(&start, 1.0, &field, &vec![0.05; blur.len()], &none, &[LensParameter::Kappa]);
    assert!(matches!(result, Err(Error::Region(m)) if m.contains("none of the unknowns")));
}

#[test]
fn what_does_not_belong_carries_no_weight() {
    let (truth, target) = (cup(), plane(&cup()));
    let mut blur = measured(&truth, 1.0, &target, 0.02, 6);
    for (i, v) in blur.iter_mut().enumerate() {
        match i % SIZE[0] {
            20..60 if i / SIZE[0] > 70 => *v += 3.0,
            140.. => *v = f32::NAN,
            _ => {}
        }
    }
    let calibration = found(&Lens { kappa: 0.5, ..truth }, 1.0, &blur, &target, &TWO);
    assert!((calibration.lens.kappa - 0.43).abs() < 0.01 && (calibration.lens.focus[1] - 869.0).abs() < 10.0);
    assert!(calibration.outliers >= 40 * 49 && calibration.residual_rms_px2 < 0.03);
    // 0.02 px² of 2.6 px² over 340 mm.
    assert!((1.0..6.0).contains(&calibration.residual_rms_mm.unwrap()));
}

#[test]
fn a_target_that_cannot_be_is_refused() {
    let (lens, blur) = (cup(), vec![0.0f32; SIZE[0] * SIZE[1]]);
    let field = Values { width: SIZE[0] as u32, values: &blur };
    let outside = Region { x: 150, y: 0, width: 20, height: 5 };
    for target in [
        Target::Plane([529.0, 20.0, 700.0]),
        Target::Plane([529.0, f64::NAN, 700.0]),
        Target::Steps(vec![(outside, 600.0)]),
        Target::Steps(vec![(Region { x: 0, y: 0, width: 5, height: 5 }, 600.0)]),
        Target::Steps(vec![]),
    ] {
        assert!(calibrate(&lens, 1.0, &field, &vec![1.0; blur.len()], &target, &TWO).is_err(), "{target:?}");
    }
}
