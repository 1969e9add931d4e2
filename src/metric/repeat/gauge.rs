//! Gauge studies of single values: type 1, and repeatability and reproducibility by a crossed analysis of variance.

use super::chance::{Chance, Interval, f_tail, intervals};
use crate::base::Error;

/// The least number of readings of a type-1 study without a warning.
pub const LEAST_READINGS: usize = 25;
/// The interaction counts as repeatability if its probability by chance is above this.
pub const POOLING: f64 = 0.05;
/// The factor of the number of distinct categories.
const CATEGORIES: f64 = 1.41;

/// Repeated readings of one value.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Repeatability {
    /// The number of readings.
    pub count: usize,
    /// Their mean.
    pub mean: f64,
    /// The standard error of the mean.
    pub mean_standard_error: f64,
    /// Their standard deviation.
    pub standard_deviation: Interval,
    /// The greatest reading less the least.
    pub range: f64,
}

impl Repeatability {
    /// Evaluates readings. `None` for fewer than two, or if one is not finite.
    pub fn of(readings: &[f64]) -> Option<Self> {
        let count = readings.len() as f64;
        let first = readings.first()?;
        // Less the first reading, so that equal readings have no scatter by rounding.
        let offset = readings.iter().map(|v| v - first).sum::<f64>() / count;
        let variance = readings.iter().map(|v| (v - first - offset).powi(2)).sum::<f64>() / (count - 1.0);
        let mean = first + offset;
        let [deviation] = intervals([variance.sqrt()], |chance| [chance.variance(variance, count - 1.0).sqrt()]);
        let (low, high) = readings.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        (readings.len() >= 2 && mean.is_finite()).then_some(())?;
        Some(Self {
            count: readings.len(),
            mean,
            mean_standard_error: (variance / count).sqrt(),
            standard_deviation: deviation?,
            range: high - low,
        })
    }
}

/// A type-1 gauge study: one part of known value, measured repeatedly.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct TypeOne {
    /// The true value.
    pub true_value: f64,
    /// The width of the tolerance.
    pub tolerance_width: f64,
    /// The mean of the readings less the true value.
    pub bias: Interval,
    /// Cg = 0.2 T / 6 s. `None` if all readings are equal.
    pub cg: Option<Interval>,
    /// Cgk = (0.1 T - |bias|) / 3 s. `None` if all readings are equal.
    pub cgk: Option<Interval>,
}

impl TypeOne {
    /// Evaluates repeated readings against the true value and the width of the tolerance.
    pub fn new(found: &Repeatability, true_value: f64, tolerance_width: f64) -> Self {
        let (s, count, bias) = (found.standard_deviation.value, found.count as f64, found.mean - true_value);
        let cg = |s: f64| 0.2 * tolerance_width / (6.0 * s);
        let cgk = |s: f64, bias: f64| (0.1 * tolerance_width - bias.abs()) / (3.0 * s);
        let [bias_interval, cg_interval, cgk_interval] = intervals([bias, cg(s), cgk(s, bias)], |chance| {
            let true_s = chance.variance(s * s, count - 1.0).sqrt();
            let true_bias = bias + true_s / count.sqrt() * chance.normal();
            [true_bias, cg(true_s), cgk(true_s, true_bias)]
        });
        let bias = bias_interval.unwrap_or(Interval { value: bias, low: f64::NAN, high: f64::NAN });
        Self { true_value, tolerance_width, bias, cg: cg_interval, cgk: cgk_interval }
    }
}

/// Readings of a gauge study: each operator measures each part in each trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Study {
    /// Number of operators, 2 or more.
    pub operators: usize,
    /// Number of parts, 2 or more.
    pub parts: usize,
    /// Number of trials, 2 or more.
    pub trials: usize,
    /// The readings: by operators, then parts, then trials.
    pub readings: Vec<f64>,
}

/// A row of an analysis of variance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct AnovaRow {
    /// `operator`, `part`, `operator x part`, `repeatability`, or `pooled error`.
    pub source: &'static str,
    /// Degrees of freedom.
    pub degrees: usize,
    /// Sum of squares.
    pub sum: f64,
    /// Mean square.
    pub mean_square: f64,
    /// The ratio to the mean square of its error. `None` for repeatability and the pooled error.
    pub f: Option<f64>,
    /// The probability of such a ratio, or a greater one, by chance.
    pub probability: Option<f64>,
}

/// A component of the variance of all readings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Component {
    /// What varies.
    pub name: &'static str,
    /// Its variance, 0 where the estimate is negative.
    pub variance: f64,
    /// Its standard deviation. `None`, as what follows, for an interaction that counts as repeatability.
    pub standard_deviation: Option<Interval>,
    /// Its variance over that of all readings, %.
    pub contribution_percent: Option<Interval>,
    /// Its standard deviation over that of all readings, %: %study variation.
    pub study_percent: Option<Interval>,
    /// Six standard deviations over the tolerance, %.
    pub tolerance_percent: Option<Interval>,
}

/// The names of the components of [`GaugeStudy`], in its order.
pub const COMPONENTS: [&str; 7] =
    ["repeatability", "operator", "operator x part", "reproducibility", "gauge R&R", "part", "total"];

/// The index of the interaction in [`COMPONENTS`].
const INTERACTION: usize = 2;

/// Gauge repeatability and reproducibility.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct GaugeStudy {
    /// Number of operators.
    pub operators: usize,
    /// Number of parts.
    pub parts: usize,
    /// Number of trials.
    pub trials: usize,
    /// The analysis of variance with the interaction. If this is pooled, the error of operators and parts is last.
    pub anova: Vec<AnovaRow>,
    /// Whether the interaction counts as repeatability, because it is no greater than chance.
    pub is_interaction_pooled: bool,
    /// The components, as in [`COMPONENTS`].
    pub components: Vec<Component>,
    /// The number of categories of parts that the gauge distinguishes, before it is rounded down: 1.41 times the
    /// standard deviation of parts over that of the gauge. `None` if the gauge does not scatter.
    pub categories: Option<Interval>,
}

/// Mean squares that variance components follow from.
#[derive(Clone, Copy)]
struct MeanSquares {
    operator: f64,
    part: f64,
    /// `None` if it is pooled.
    interaction: Option<f64>,
    error: f64,
}

impl Study {
    /// Analyses the variance (AIAG, *Measurement Systems Analysis*, 4th edition, chapter III B). `tolerance` is the
    /// width of the tolerance, in the unit of the readings.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the study is not complete, or has fewer than two operators, parts or trials.
    pub fn analyse(&self, tolerance: Option<f64>) -> Result<GaugeStudy, Error> {
        self.check()?;
        let (o, p, r) = (self.operators as f64, self.parts as f64, self.trials as f64);
        let sums = self.sums_of_squares();
        let degrees = [o - 1.0, p - 1.0, (o - 1.0) * (p - 1.0), o * p * (r - 1.0)];
        let squares: [f64; 4] = std::array::from_fn(|n| sums[n] / degrees[n]);
        let ratio = |n: usize, error: usize| {
            let f = squares[n] / squares[error];
            (f, f_tail(f, [degrees[n], degrees[error]]))
        };
        let (_, by_chance) = ratio(2, 3);
        let is_interaction_pooled = by_chance > POOLING;
        let pooled = [degrees[2] + degrees[3], (sums[2] + sums[3]) / (degrees[2] + degrees[3])];
        let main = |n: usize| match is_interaction_pooled {
            true => {
                let f = squares[n] / pooled[1];
                (f, f_tail(f, [degrees[n], pooled[0]]))
            }
            false => ratio(n, 2),
        };
        let row = |n: usize, source, f: Option<(f64, f64)>| {
            let f = f.filter(|(f, _)| !f.is_nan());
            let [f, probability] = [f.map(|f| f.0), f.map(|f| f.1)];
            AnovaRow { source, degrees: degrees[n] as usize, sum: sums[n], mean_square: squares[n], f, probability }
        };
        let mut anova = vec![
            row(0, "operator", Some(main(0))),
            row(1, "part", Some(main(1))),
            row(2, "operator x part", Some(ratio(2, 3))),
            row(3, "repeatability", None),
        ];
        if is_interaction_pooled {
            let (degrees, sum) = (pooled[0] as usize, sums[2] + sums[3]);
            let (source, mean_square) = ("pooled error", pooled[1]);
            anova.push(AnovaRow { source, degrees, sum, mean_square, f: None, probability: None });
        }
        let found = MeanSquares {
            operator: squares[0],
            part: squares[1],
            interaction: (!is_interaction_pooled).then_some(squares[2]),
            error: if is_interaction_pooled { pooled[1] } else { squares[3] },
        };
        let draw = |chance: &mut Chance| MeanSquares {
            operator: chance.variance(found.operator, degrees[0]),
            part: chance.variance(found.part, degrees[1]),
            interaction: found.interaction.map(|square| chance.variance(square, degrees[2])),
            error: chance.variance(found.error, if is_interaction_pooled { pooled[0] } else { degrees[3] }),
        };
        let (components, categories) = self.components(&found, draw, tolerance);
        let Self { operators, parts, trials, .. } = *self;
        Ok(GaugeStudy { operators, parts, trials, anova, is_interaction_pooled, components, categories })
    }

    /// Checks that the study is complete.
    fn check(&self) -> Result<(), Error> {
        let Self { operators, parts, trials, readings } = self;
        if [*operators, *parts, *trials].iter().any(|count| *count < 2) {
            let problem = format!("{operators} operators, {parts} parts and {trials} trials; give two or more of each");
            return Err(Error::Mismatch(format!("a gauge study has {problem}")));
        }
        if readings.len() != operators * parts * trials || readings.iter().any(|v| !v.is_finite()) {
            let problem = "a gauge study needs one reading of each operator, part and trial";
            return Err(Error::Mismatch(problem.to_string()));
        }
        Ok(())
    }

    /// Returns the sums of squares of operators, parts, their interaction and the repetitions.
    fn sums_of_squares(&self) -> [f64; 4] {
        let Self { operators, parts, trials, readings } = self;
        // Sums of squares below this are rounding.
        let most = readings.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let least = (1e-12 * most).powi(2) * readings.len() as f64;
        let readings: Vec<f64> = readings.iter().map(|v| v - readings[0]).collect();
        let mean = |of: &dyn Fn(usize, usize) -> bool| {
            let chosen = readings.iter().enumerate();
            let chosen = chosen.filter(|(n, _)| of(n / trials / parts, n / trials % parts)).map(|(_, v)| *v);
            let (sum, count) = chosen.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
            sum / count
        };
        let (o, p, r) = (*operators as f64, *parts as f64, *trials as f64);
        let all = mean(&|_, _| true);
        let by_operator: Vec<f64> = (0..*operators).map(|i| mean(&|a, _| a == i)).collect();
        let by_part: Vec<f64> = (0..*parts).map(|j| mean(&|_, b| b == j)).collect();
        let cells: Vec<f64> = readings.chunks_exact(*trials).map(|cell| cell.iter().sum::<f64>() / r).collect();
        let cell = |n: usize, mean: &f64| mean - by_operator[n / parts] - by_part[n % parts] + all;
        let sums = [
            p * r * by_operator.iter().map(|m| (m - all).powi(2)).sum::<f64>(),
            o * r * by_part.iter().map(|m| (m - all).powi(2)).sum::<f64>(),
            r * cells.iter().enumerate().map(|(n, mean)| cell(n, mean).powi(2)).sum::<f64>(),
            readings.iter().enumerate().map(|(n, v)| (v - cells[n / trials]).powi(2)).sum::<f64>(),
        ];
        sums.map(|sum| if sum < least { 0.0 } else { sum })
    }

    /// Returns the components with their intervals, and the number of categories.
    fn components(
        &self,
        found: &MeanSquares,
        draw: impl Fn(&mut Chance) -> MeanSquares,
        tolerance: Option<f64>,
    ) -> (Vec<Component>, Option<Interval>) {
        // For each component: standard deviation, contribution, share of the study, share of the tolerance.
        let quantities = |squares: &MeanSquares| {
            let variances = self.variances(squares);
            let total = variances[6];
            let tolerance = tolerance.unwrap_or(f64::NAN);
            let mut all = [0.0; 29];
            for (n, variance) in variances.iter().enumerate() {
                let (deviation, share) = (variance.sqrt(), variance / total);
                let of = [deviation, 100.0 * share, 100.0 * share.sqrt(), 600.0 * deviation / tolerance];
                all[4 * n..4 * n + 4].copy_from_slice(&of);
            }
            all[28] = CATEGORIES * (variances[5] / variances[4]).sqrt();
            all
        };
        let all = intervals(quantities(found), |chance| quantities(&draw(chance)));
        let variances = self.variances(found);
        let component = |n: usize| {
            let of =
                |quantity: usize| all[4 * n + quantity].filter(|_| n != INTERACTION || found.interaction.is_some());
            Component {
                name: COMPONENTS[n],
                variance: variances[n],
                standard_deviation: of(0),
                contribution_percent: of(1),
                study_percent: of(2),
                tolerance_percent: of(3),
            }
        };
        ((0..COMPONENTS.len()).map(component).collect(), all[28])
    }

    /// Returns the variances of [`COMPONENTS`], 0 where an estimate is negative.
    fn variances(&self, squares: &MeanSquares) -> [f64; 7] {
        let (o, p, r) = (self.operators as f64, self.parts as f64, self.trials as f64);
        let (repeatability, error) = (squares.error, squares.interaction.unwrap_or(squares.error));
        let operator = ((squares.operator - error) / (p * r)).max(0.0);
        let interaction = squares.interaction.map_or(0.0, |square| ((square - repeatability) / r).max(0.0));
        let part = ((squares.part - error) / (o * r)).max(0.0);
        let reproducibility = operator + interaction;
        let gauge = repeatability + reproducibility;
        [repeatability, operator, interaction, reproducibility, gauge, part, gauge + part]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// The example of AIAG, *Measurement Systems Analysis*, 4th edition (2010), chapter III: 10 parts, appraisers A, B
    /// and C, 3 trials. A row is one trial of one appraiser. Also in McNeese 2015, *Three Ways to Analyze a Gage R&R
    /// Study*, table 1 (spcforexcel.com).
    const AIAG: [[f64; 10]; 9] = [
        [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
        [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
        [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
        [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
        [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
        [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
        [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
    ];

    fn aiag() -> Study {
        let reading = |n: usize| AIAG[n / 30 * 3 + n % 3][n / 3 % 10];
        Study { operators: 3, parts: 10, trials: 3, readings: (0..90).map(reading).collect() }
    }

    fn close(found: f64, expected: f64, within: f64) {
        assert!((found - expected).abs() <= within, "{found}, expected {expected}");
    }

    #[test]
    fn the_published_example_of_aiag_is_reproduced() {
        let found = aiag().analyse(None).unwrap();
        // The table of the analysis of variance: degrees, sum, mean square, F.
        let published = [
            (2, 3.1673, 1.58363, Some(39.617)),
            (9, 88.3619, 9.81799, Some(245.614)),
            (18, 0.3590, 0.01994, Some(0.434)),
            (60, 2.7589, 0.04598, None),
        ];
        for (row, (degrees, sum, square, f)) in found.anova.iter().zip(published) {
            assert_eq!(row.degrees, degrees);
            close(row.sum, sum, 6e-5);
            close(row.mean_square, square, 6e-6);
            match f {
                Some(f) => close(row.f.unwrap(), f, 6e-4),
                None => assert_eq!(row.f, None),
            }
        }
        close(found.anova[2].probability.unwrap(), 0.974, 5e-4);
        let pooled = &found.anova[4];
        assert_eq!((pooled.source, pooled.degrees, found.anova.len()), ("pooled error", 78, 5));
        close(found.anova[0].f.unwrap(), found.anova[0].mean_square / pooled.mean_square, 1e-12);
        // The interaction is not significant, and pooled.
        assert!(found.is_interaction_pooled && found.components[INTERACTION].standard_deviation.is_none());
        for (name, variance, deviation, study) in [
            ("repeatability", 0.039973, 0.199933, 18.4),
            ("operator", 0.051455, 0.226838, 20.9),
            ("gauge R&R", 0.091428, 0.302373, 27.9),
            ("part", 1.086446, 1.042327, 96.0),
        ] {
            let component = found.components.iter().find(|component| component.name == name).unwrap();
            close(component.variance, variance, 6e-6);
            close(component.standard_deviation.unwrap().value, deviation, 6e-6);
            close(component.study_percent.unwrap().value, study, 0.06);
            assert_eq!(component.tolerance_percent, None);
        }
        assert_eq!(found.categories.unwrap().value.floor(), 4.0);
    }

    #[test]
    fn an_interaction_is_found_and_closed_forms_hold() {
        // Part means 10, 20, 30, operators 0, 5, -5, an interaction without row and column sums, noise ±1: sums of
        // squares 300, 1200, 192 and 18, so that the variances are 2, (48 - 2)/2, (150 - 48)/6 and (600 - 48)/6.
        let interaction = [[4.0, -4.0, 0.0], [-4.0, 0.0, 4.0], [0.0, 4.0, -4.0]];
        let reading = |n: usize| {
            let (a, b) = (n / 6, n / 2 % 3);
            10.0 * (b + 1) as f64
                + [0.0, 5.0, -5.0][a]
                + interaction[a][b]
                + if n.is_multiple_of(2) { -1.0 } else { 1.0 }
        };
        let study = Study { operators: 3, parts: 3, trials: 2, readings: (0..18).map(reading).collect() };
        let found = study.analyse(Some(100.0)).unwrap();
        assert!(!found.is_interaction_pooled);
        for (component, variance) in found.components.iter().zip([2.0, 17.0, 23.0, 40.0, 42.0, 92.0, 134.0]) {
            close(component.variance, variance, 1e-9);
            close(component.tolerance_percent.unwrap().value, 6.0 * variance.sqrt(), 1e-9);
        }
        close(found.categories.unwrap().value, 1.41 * (92.0f64 / 42.0).sqrt(), 1e-9);
    }

    #[test]
    fn intervals_hold_the_truth_of_simulated_studies() {
        let mut random = Random::new(3, 0);
        let mut inside = [0; 3];
        for _ in 0..40 {
            let operators: Vec<f64> = (0..3).map(|_| 0.5 * random.normal()).collect();
            let parts: Vec<f64> = (0..8).map(|_| 2.0 * random.normal()).collect();
            let readings = (0..72).map(|n| operators[n / 24] + parts[n / 3 % 8] + 0.4 * random.normal()).collect();
            let found = Study { operators: 3, parts: 8, trials: 3, readings }.analyse(None).unwrap();
            for (n, (component, truth)) in [(0, 0.4), (1, 0.5), (5, 2.0)].into_iter().enumerate() {
                let interval = found.components[component].standard_deviation.unwrap();
                inside[n] += usize::from((interval.low..=interval.high).contains(&truth));
            }
        }
        println!("{inside:?} of 40");
        assert!(inside.iter().all(|count| *count >= 34), "{inside:?} of 40");
    }

    #[test]
    fn type_one_indices_are_those_of_their_definition() {
        let readings: Vec<f64> = (0..30).map(|n| 10.02 + if n % 2 == 0 { 0.01 } else { -0.01 }).collect();
        let found = Repeatability::of(&readings).unwrap();
        let s = 0.01 * (30.0f64 / 29.0).sqrt();
        close(found.standard_deviation.value, s, 1e-12);
        close(found.range, 0.02, 1e-12);
        let one = TypeOne::new(&found, 10.0, 1.0);
        let (cg, cgk) = (one.cg.unwrap(), one.cgk.unwrap());
        close(cg.value, 0.2 / (6.0 * s), 1e-9);
        close(cgk.value, (0.1 - 0.02) / (3.0 * s), 1e-9);
        // The interval of a standard deviation of 29 degrees is -20.4 % to +34.4 %.
        close(cg.low / cg.value, 1.0 / 1.344, 0.02);
        close(cg.high / cg.value, 1.0 / 0.796, 0.02);
        assert!(one.bias.low > 0.015 && one.bias.high < 0.025 && cgk.low < cgk.value);
        for (value, count) in [(5.0, 4), (0.1, 25)] {
            let constant = Repeatability::of(&vec![value; count]).unwrap();
            let one = TypeOne::new(&constant, value, 1.0);
            assert_eq!((constant.mean, constant.standard_deviation.value, one.cg, one.cgk), (value, 0.0, None, None));
        }
        assert_eq!((Repeatability::of(&[1.0]), Repeatability::of(&[1.0, f64::NAN])), (None, None));
    }

    #[test]
    fn incomplete_studies_are_refused() {
        for (operators, trials, readings) in [(1, 3, 30), (3, 1, 30), (3, 3, 89)] {
            let study = Study { operators, parts: 10, trials, readings: vec![1.0; readings] };
            assert!(matches!(study.analyse(None), Err(Error::Mismatch(_))));
        }
        // Without any scatter there is no ratio.
        for value in [1.0, 0.1] {
            let flat = Study { operators: 3, parts: 2, trials: 4, readings: vec![value; 24] }.analyse(None).unwrap();
            assert!(flat.categories.is_none() && flat.anova.iter().all(|row| row.f.is_none()));
        }
        // Nor if only parts differ, by numbers that are not exact.
        let readings = (0..54).map(|n| [0.1, 0.7, 12.3][n / 3 % 3]).collect();
        let parts = Study { operators: 6, parts: 3, trials: 3, readings }.analyse(None).unwrap();
        assert!(parts.categories.is_none() && parts.components[4].variance == 0.0, "{parts:?}");
    }
}
