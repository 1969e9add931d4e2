//! Solves a pair in memory and checks its known relative blur and registration.

use embedder::{SHIFT, pair, validate};
use parfocal::{Engine, EngineOptions, Error, PairSolver, Settings, SolveOptions};

fn main() -> Result<(), Error> {
    let [i1, i2] = pair(|_| 1.0);
    let engine = Engine::new(&EngineOptions { validation: validate(), ..EngineOptions::default() })?;
    let solution = PairSolver::new(&engine, &Settings::default())?.solve([&i1, &i2], &SolveOptions::default())?;

    let mut blur: Vec<f32> = solution.relative_blur.iter().copied().filter(|v| !v.is_nan()).collect();
    blur.sort_unstable_by(f32::total_cmp);
    let ([tx, ty], median) = (solution.transform.translation(), f64::from(blur[blur.len() / 2]));
    println!("{}: V {median:.3} px², T {:.3} {:.3} px", engine.info().name, tx, ty);
    assert!((median - 1.0).abs() < 0.05, "V {median}");
    assert!((tx - SHIFT[0]).hypot(ty - SHIFT[1]) < 0.05, "{tx} {ty}");
    assert!(engine.validation_messages().is_empty(), "{:?}", engine.validation_messages());
    Ok(())
}
