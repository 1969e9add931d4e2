//! Solves a pair from memory whose relative blur and registration are known.

use parfocal::{Engine, EngineOptions, Error, Frame, Settings, Solver};

const SIZE: u32 = 96;
/// Of the blur of I1 and of I2, px²; V is their difference.
const VARIANCE: [f64; 2] = [0.5, 1.5];
/// A place in I2 less the same in I1, px.
const SHIFT: [f64; 2] = [0.8, -0.6];

/// Waves in all directions, seen through a Gaussian of some variance, which it dims as its transfer function says.
fn photograph(variance: f64, [dx, dy]: [f64; 2]) -> Result<Frame, String> {
    let waves: Vec<[f64; 3]> = (0..64)
        .map(|n| f64::from(n) * 2.4)
        .map(|n| [(0.2 + 0.006 * n) * n.cos(), (0.2 + 0.006 * n) * n.sin(), n * n])
        .collect();
    let value = |x: f64, y: f64| {
        let wave = |[u, v, phase]: &[f64; 3]| (-variance * (u * u + v * v) / 2.0).exp() * (u * x + v * y + phase).cos();
        (0.5 + 0.04 * waves.iter().map(wave).sum::<f64>()) as f32
    };
    let places = (0..SIZE * SIZE).map(|i| (f64::from(i % SIZE) - dx, f64::from(i / SIZE) - dy));
    Frame::gray(SIZE, SIZE, places.map(|(x, y)| value(x, y)).collect())
}

fn main() -> Result<(), Error> {
    let [i1, i2] = [photograph(VARIANCE[0], [0.0; 2]), photograph(VARIANCE[1], SHIFT)].map(|f| f.expect("a frame"));
    let engine = Engine::new(&EngineOptions { validation: validate(), ..EngineOptions::default() })?;
    let solution = Solver::for_pair(&engine, &i1, &i2, &Settings::default())?.solve(&i1, &i2)?;

    let mut blur: Vec<f32> = solution.relative_blur.iter().copied().filter(|v| !v.is_nan()).collect();
    blur.sort_unstable_by(f32::total_cmp);
    let ([tx, ty], median) = (solution.transform.translation(), f64::from(blur[blur.len() / 2]));
    println!("{}: V {median:.3} px², T {:.3} {:.3} px", engine.info().name, tx, ty);
    assert!((median - (VARIANCE[1] - VARIANCE[0])).abs() < 0.05, "V {median}");
    assert!((tx - SHIFT[0]).hypot(ty - SHIFT[1]) < 0.05, "{tx} {ty}");
    assert!(engine.validation_messages().is_empty(), "{:?}", engine.validation_messages());
    Ok(())
}

fn validate() -> bool {
    std::env::var_os("PARFOCAL_VALIDATE").is_some_and(|value| value == "1")
}
