//! Where each pixel is in focus, from the relative blur of every pair of neighbours.
//!
//! Between lens and sensor the blur of a point grows with the distance of the focus setting p from the point's own, u:
//! its variance is c (p - u)², in settings that are even in 1/z. So the relative blur of neighbours p₀ and p₁ is linear in u,
//!
//! ```text
//! V = c (p₁ - u)² - c (p₀ - u)² = 2 c Δ (m - u),   Δ = p₁ - p₀,  m = (p₀ + p₁)/2
//! ```
//!
//! and each pair tells u = m - V/(2 c Δ) with the deviation σ_V/(2 c |Δ|). Where both are blurred widely σ_V is large and
//! the pair says little; the pairs around the focus decide.

use crate::around::resample::in_rows;

/// One pair of neighbours, on the pixels of the reference frame.
pub(crate) struct Observation {
    /// The settings of its frames.
    pub(crate) positions: [f64; 2],
    /// V, NaN where not valid, and its standard deviation, px².
    pub(crate) measured: Vec<[f32; 2]>,
}

impl Observation {
    fn middle(&self) -> f64 {
        (self.positions[0] + self.positions[1]) / 2.0
    }

    fn step(&self) -> f64 {
        self.positions[1] - self.positions[0]
    }

    /// V/(2 Δ), and its deviation: c (m - u).
    fn scaled(&self, measured: [f32; 2]) -> Option<(f64, f64)> {
        let [v, deviation] = measured.map(f64::from);
        let over = 2.0 * self.step();
        let deviation = deviation.hypot(SYSTEMATIC * v);
        (!v.is_nan() && deviation < NOTHING).then(|| (v / over, (deviation / over).max(LEAST)))
    }
}

/// V is off by such a share of itself besides what its deviation says, since blur is no exact Gaussian and a wide blur is
/// told as less than it is: on the heat sink's sweep pairs far from a narrow fin's focus tell half of their V.
const SYSTEMATIC: f64 = 0.5;
/// Least deviation of V over two steps.
const LEAST: f64 = 1e-6;
/// A deviation of V from which on nothing is said, px².
const NOTHING: f64 = 30.0;
/// At most so many pixels of each pair are asked for c.
const ASKED: usize = 20_000;
/// A pixel tells of c only where its deviation is less than such a share of c.
const SURE: f64 = 0.2;
/// Where a pair is off by so many of its deviations, it counts half.
const DOUBTED: f64 = 3.0;

/// c, px² a squared setting, of settings that ascend: the median over pixels and neighbouring pairs; nothing where no pixel
/// tells, or where blur falls away from the focus more often than it rises.
///
/// Only the two pairs between whose middles the focus lies are asked, which V's signs show. Farther away both of a pair's
/// frames are blurred widely, what is left of the texture says ever less, and c would come out too small: on the heat
/// sink's sweep 7 where it is 18. All pixels count alike, for V is the surer the smaller it is, and so is c.
pub(crate) fn blur_rate(pairs: &[Observation]) -> Option<f64> {
    let (mut rates, mut against) = (Vec::new(), 0);
    for neighbours in pairs.windows(2) {
        let pixels = neighbours[0].measured.len();
        let apart = neighbours[1].middle() - neighbours[0].middle();
        for i in (0..pixels).step_by((pixels / ASKED).max(1)) {
            let [(a, da), (b, db)] = [0, 1].map(|n| {
                let over = 2.0 * neighbours[n].step();
                let [v, deviation] = neighbours[n].measured[i].map(f64::from);
                (v / over, deviation / over)
            });
            if da.hypot(db) >= SURE * (b - a).abs() {
                continue;
            }
            if a < 0.0 && b > 0.0 {
                rates.push((b - a) / apart);
            } else if a > 0.0 && b < 0.0 {
                against += 1;
            }
        }
    }
    if rates.len() <= against {
        return None;
    }
    let middle = rates.len() / 2;
    Some(*rates.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// What one pair tells of u at each pixel, and with what deviation; NaN where it tells nothing. Asked for in every round,
/// so it is kept, in the memory of the pair.
type Told = Vec<[f32; 2]>;

fn told_of(mut pair: Observation, rate: f64, width: usize) -> Told {
    let mut told = std::mem::take(&mut pair.measured);
    in_rows(&mut told, width, |_, row| {
        for pixel in row {
            let found =
                pair.scaled(*pixel).map(|(scaled, deviation)| [pair.middle() - scaled / rate, deviation / rate]);
            *pixel = found.map_or([f32::NAN; 2], |found| found.map(|v| v as f32));
        }
    });
    told
}

/// What the pairs tell of a pixel.
fn at(pairs: &[Told], i: usize) -> impl Iterator<Item = (f64, f64)> + '_ {
    let all = pairs.iter().map(move |told| (f64::from(told[i][0]), f64::from(told[i][1])));
    all.filter(|(u, _)| !u.is_nan())
}

/// u of every pixel and its standard deviation, in settings; NaN where no pair tells.
pub(crate) fn combine(pairs: Vec<Observation>, rate: f64, width: usize) -> Vec<[f32; 2]> {
    let positions = || pairs.iter().flat_map(|pair| pair.positions);
    let (least, most) = positions().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), p| (l.min(p), m.max(p)));
    let step = (most - least) / pairs.len().max(1) as f64;
    let pixels = pairs.first().map_or(0, |pair| pair.measured.len());
    let pairs: Vec<Told> = pairs.into_iter().map(|pair| told_of(pair, rate, width)).collect();
    let mut focus = vec![[f32::NAN; 2]; pixels];
    in_rows(&mut focus, width, |y, row| {
        let mut told = Vec::with_capacity(pairs.len());
        for (x, focus) in row.iter_mut().enumerate() {
            told.clear();
            told.extend(at(&pairs, y * width + x));
            if let Some((u, deviation)) = agreed(&mut told) {
                *focus = [u as f32, deviation as f32];
            }
        }
    });
    for _ in 0..ROUNDS {
        focus = smoothed(&pairs, width, focus);
    }
    for pixel in &mut focus {
        let [u, deviation] = pixel.map(f64::from);
        if !(least - step..=most + step).contains(&u) || deviation > UNSURE * step {
            *pixel = [f32::NAN; 2];
        }
    }
    focus
}

/// Deviations of u above so many steps, like u more than a step outside the sweep, are no answer.
const UNSURE: f64 = 2.0;

/// Times that the smoothness is linearised about what was found.
const ROUNDS: usize = 6;
/// Red-black sweeps each time.
const SWEEPS: usize = 8;
/// Over-relaxation.
const OMEGA: f64 = 1.6;
/// Weight of the total variation of u.
const SMOOTHNESS: f64 = 0.05;
/// Slopes below this count by their square, settings a pixel.
const SLOPE: f64 = 0.1;
/// Pixels that share one residual: V's errors are as wide as its window.
const SHARED: f64 = 100.0;

/// One round of `Σ_k log(1 + (u - u_k)²/(3σ_k)²) + λ |∇u|` with lagged weights: neighbours decide between pairs that
/// contradict each other, and steps stay.
fn smoothed(pairs: &[Told], width: usize, focus: Vec<[f32; 2]>) -> Vec<[f32; 2]> {
    let height = focus.len() / width;
    // The weights that hold u, and where; then the diffusivity.
    let mut system = vec![[0.0f64; 3]; focus.len()];
    in_rows(&mut system, width, |y, row| {
        let u_at = |x: usize, y: usize| f64::from(focus[y * width + x][0]);
        for (x, system) in row.iter_mut().enumerate() {
            let u = u_at(x, y);
            let (mut weights, mut sum) = (0.0, 0.0);
            for (told, deviation) in at(pairs, y * width + x) {
                let weight = 1.0 / (deviation * deviation * (1.0 + ((told - u) / (DOUBTED * deviation)).powi(2)));
                weights += weight / SHARED;
                sum += weight / SHARED * told;
            }
            let dx = (u_at((x + 1).min(width - 1), y) - u_at(x.saturating_sub(1), y)) / 2.0;
            let dy = (u_at(x, (y + 1).min(height - 1)) - u_at(x, y.saturating_sub(1))) / 2.0;
            let slope = dx * dx + dy * dy;
            let diffusivity = if slope.is_nan() { 0.0 } else { SMOOTHNESS / (slope + SLOPE * SLOPE).sqrt() };
            *system = [weights, sum, diffusivity];
        }
    });
    let mut colors = [0, 1].map(|_| focus.to_vec());
    for half in 0..2 * SWEEPS {
        let color = half % 2;
        let [red, black] = &mut colors;
        let (own, other) = if color == 0 { (red, &*black) } else { (black, &*red) };
        in_rows(own, width, |y, row| {
            for x in ((y + color) % 2..width).step_by(2) {
                if row[x][0].is_nan() {
                    continue;
                }
                let i = y * width + x;
                let [mut weights, mut sum, diffusivity] = system[i];
                let beside = [
                    (x > 0).then(|| i - 1),
                    (x + 1 < width).then(|| i + 1),
                    (y > 0).then(|| i - width),
                    (y + 1 < height).then(|| i + width),
                ];
                for n in beside.into_iter().flatten().filter(|&n| !other[n][0].is_nan()) {
                    let a = (diffusivity + system[n][2]) / 2.0;
                    weights += a;
                    sum += a * f64::from(other[n][0]);
                }
                if weights > 0.0 {
                    let u = f64::from(row[x][0]);
                    row[x][0] = (u + OMEGA * (sum / weights - u)) as f32;
                }
            }
        });
    }
    let [red, black] = colors;
    (0..focus.len()).map(|i| if (i % width + i / width).is_multiple_of(2) { red[i] } else { black[i] }).collect()
}

/// The mean of values by their deviations; those far from what the surest say count less (Cauchy's weights). Its
/// deviation is raised where they contradict each other.
fn agreed(told: &mut [(f64, f64)]) -> Option<(f64, f64)> {
    told.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut mean = told.first()?.0;
    let mut deviation = told[0].1;
    for _ in 0..3 {
        let (mut sum, mut weights, mut misfit) = (0.0, 0.0, 0.0);
        for &(u, s) in told.iter() {
            let off = (u - mean) / s;
            let weight = 1.0 / (s * s * (1.0 + (off / DOUBTED).powi(2)));
            sum += weight * u;
            weights += weight;
            misfit += weight * (u - mean).powi(2);
        }
        mean = sum / weights;
        let excess = (misfit / (told.len() as f64 - 1.0).max(1.0)).sqrt().max(1.0);
        deviation = excess / weights.sqrt();
    }
    Some((mean, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// V of pairs of neighbours on a ramp of u, by the formula; beyond |V| 40 px² saturated, which says nothing.
    fn pairs(positions: &[f64], rate: f64, width: usize) -> (Vec<Observation>, Vec<f64>) {
        let u: Vec<f64> = (0..width).map(|i| 0.5 + 5.0 * i as f64 / width as f64).collect();
        let of = |pair: &[f64]| {
            let v = u.iter().map(|u| rate * ((pair[1] - u).powi(2) - (pair[0] - u).powi(2)));
            let measured =
                v.map(|v| if v.abs() < 40.0 { [v as f32, 0.1 + 0.01 * v.abs() as f32] } else { [f32::NAN; 2] });
            Observation { positions: [pair[0], pair[1]], measured: measured.collect() }
        };
        (positions.windows(2).map(of).collect(), u)
    }

    #[test]
    fn the_rate_and_the_focus_come_back_though_wide_blur_saturates() {
        // Uneven settings, and 4 px² a squared setting: five settings away V would be 100 px².
        let (pairs, u) = pairs(&[0.0, 1.0, 2.0, 3.5, 5.0, 6.0], 4.0, 400);
        let rate = blur_rate(&pairs).unwrap();
        assert!((rate - 4.0).abs() < 0.02, "{rate}");
        let found = combine(pairs, rate, 400);
        for ([found, deviation], u) in found.iter().zip(&u) {
            assert!((f64::from(*found) - u).abs() < 0.03, "{found} {u}");
            assert!((1e-3..0.3).contains(deviation), "{deviation}");
        }
    }

    #[test]
    fn pixels_that_no_pair_sees_have_no_focus() {
        let (mut pairs, _) = pairs(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 4.0, 10);
        for pair in &mut pairs {
            pair.measured[3][0] = f32::NAN;
            pair.measured[5][1] = 1000.0;
        }
        let found = combine(pairs, 4.0, 10);
        assert!(
            found.iter().enumerate().all(|(i, [u, s])| u.is_nan() == (i == 3 || i == 5) && u.is_nan() == s.is_nan())
        );
        assert_eq!(blur_rate(&[]), None);
    }

    #[test]
    fn one_pair_that_contradicts_surer_ones_is_outvoted_and_doubt_grows() {
        let (u, deviation) = agreed(&mut [(2.0, 0.1), (2.1, 0.1), (9.0, 0.5)]).unwrap();
        assert!((u - 2.05).abs() < 0.1, "{u}");
        assert!(deviation > 0.1, "{deviation}");
    }
}
