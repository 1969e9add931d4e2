//! What a camera or a program did to a photograph after its exposure: compression in blocks, compared on the windows of
//! a solved pair. Section 5 of `docs/method.md`.

use super::stages::spline::Field;

/// The side of the blocks that JPEG compresses each by itself, px.
const BLOCK: usize = 8;
/// The least step at the borders of blocks over that at the next largest place, by which blocks are seen.
///
/// Of a slanted plane, a relief and plates, compressed with a quality of 10, 20, 30, 50 and 75, it was 3.4 to 5.3, 2.0
/// to 2.7, 1.6 to 2.1, 1.4 to 1.7 and 1.2 to 1.4, and V was beyond 3 σ at 11 to 18, 13 to 16, 14 to 17, 3 to 9 and 2 to
/// 3 % of the pixels. JPEG photographs of cameras have up to 1.44, pictures without blocks up to 1.03.
const LEAST_STEP: f64 = 1.6;
/// The most of all change along an axis that may lie at the borders of blocks. Squares of 8 px, as of a chart, change
/// nowhere else; the worst JPEG changes inside of its blocks too.
const MOST_AT_BORDERS: f64 = 0.6;

/// The change from pixel to pixel of one photograph, summed by place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Steps {
    /// Σ |difference| along x and along y, by the place of the first of both pixels from the first of a block.
    sums: [[f64; BLOCK]; 2],
    /// The number of differences.
    counts: [[f64; BLOCK]; 2],
}

impl Steps {
    /// Of a part of a photograph, whose first pixel lies at `origin`.
    pub(crate) fn of(part: &Field, origin: [u32; 2]) -> Self {
        let mut steps = Self::default();
        for y in 0..part.height - 1 {
            for x in 0..part.width - 1 {
                let value = part.get(x, y);
                for (axis, next) in [part.get(x + 1, y), part.get(x, y + 1)].into_iter().enumerate() {
                    let place = (origin[axis] as usize + [x, y][axis]) % BLOCK;
                    steps.sums[axis][place] += (next - value).abs();
                    steps.counts[axis][place] += 1.0;
                }
            }
        }
        steps
    }

    pub(crate) fn add(&mut self, other: &Self) {
        let add = |sum: &mut [[f64; BLOCK]; 2], other: &[[f64; BLOCK]; 2]| {
            sum.iter_mut().flatten().zip(other.iter().flatten()).for_each(|(sum, v)| *sum += v);
        };
        add(&mut self.sums, &other.sums);
        add(&mut self.counts, &other.counts);
    }

    /// Whether the photograph was compressed in blocks that show: its values step at one place in 8 along both axes.
    fn has_blocks(&self) -> bool {
        let along = |axis: usize| {
            let mut means: [f64; BLOCK] = std::array::from_fn(|n| self.sums[axis][n] / self.counts[axis][n]);
            means.sort_by(f64::total_cmp);
            let [.., second, largest] = means;
            largest > LEAST_STEP * second && largest < MOST_AT_BORDERS * means.iter().sum::<f64>()
        };
        along(0) && along(1)
    }
}

/// The warning if one of the photographs, or both, were compressed in blocks that show.
pub(crate) fn blocks_warning(steps: &[Steps; 2]) -> Option<String> {
    let which = match steps.each_ref().map(Steps::has_blocks) {
        [false, false] => return None,
        [true, false] => "I1 was",
        [false, true] => "I2 was",
        [true, true] => "both photographs were",
    };
    Some(format!(
        "{which} compressed as JPEG so far that its blocks of {BLOCK} px show, and V is off by more than its standard deviation says: save with a quality of 75 or more, or without loss"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// Smooth waves, noise, and blocks of random height. The picture begins `phase` px inside of a block.
    fn picture(noise: f64, step: f64, phase: usize, seed: u64) -> Field {
        let mut random = Random::new(seed, 1);
        let heights: Vec<f64> = (0..400).map(|_| step * random.normal()).collect();
        let noise: Vec<f64> = (0..64 * 48).map(|_| noise * random.normal()).collect();
        Field::from_fn(64, 48, |x, y| {
            let wave = 0.1 * (0.31 * x as f64).sin() * (0.23 * y as f64).cos();
            wave + heights[(y + phase) / BLOCK * 20 + (x + phase) / BLOCK] + noise[y * 64 + x]
        })
    }

    #[test]
    fn steps_of_8_px_are_blocks_wherever_they_begin() {
        for seed in 1..5 {
            for phase in [0, 3, 7] {
                let of = |noise, step| Steps::of(&picture(noise, step, phase, seed), [5, 2]);
                let [without, with] = [of(0.003, 0.0), of(0.003, 0.05)];
                assert!(!without.has_blocks() && with.has_blocks(), "{phase}: {without:?} {with:?}");
                // Noise hides small ones.
                assert!(!of(0.03, 0.005).has_blocks());
            }
        }
    }

    #[test]
    fn windows_add_up_by_their_place_in_the_photograph() {
        let picture = picture(0.003, 0.05, 0, 1);
        // They share a column, so that each difference is in one of them.
        let part = |x: usize, width| Field::from_fn(width, 48, |i, j| picture.get(x + i, j));
        let mut sum = Steps::of(&part(0, 32), [0, 0]);
        sum.add(&Steps::of(&part(31, 33), [31, 0]));
        let whole = Steps::of(&picture, [0, 0]);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!((0..BLOCK).all(|n| close(sum.sums[0][n], whole.sums[0][n])), "{sum:?} {whole:?}");
    }

    #[test]
    fn squares_of_a_chart_are_no_blocks() {
        for blur in [0.0, 0.5, 1.0] {
            // The share of a square's side that a pixel of a blurred picture sees.
            let edge = |x: usize| {
                let at = (x % 16) as f64 + 0.5 - 8.0;
                if blur == 0.0 { f64::from(at > 0.0) } else { 0.5 + 0.5 * (at / blur).tanh() }
            };
            let chart = Field::from_fn(64, 64, |x, y| (edge(x) - 0.5) * (edge(y) - 0.5));
            assert!(!Steps::of(&chart, [0, 0]).has_blocks(), "{blur}");
        }
    }

    #[test]
    fn the_warning_names_the_photographs() {
        let [none, some] = [0.0, 0.05].map(|step| Steps::of(&picture(0.003, step, 0, 1), [0, 0]));
        let said = |steps| blocks_warning(&steps).unwrap_or_default();
        assert_eq!(said([none, none]), "");
        assert!(said([none, some]).starts_with("I2 was compressed") && said([some, none]).starts_with("I1 was"));
        assert!(said([some, some]).starts_with("both photographs were compressed as JPEG"));
    }
}
