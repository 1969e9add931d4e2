//! How much brighter one photograph is than the other from place to place: the CPU reference of `glsl/include/shading.glsl`.

/// Sum of the degrees along x and y at most.
const DEGREE: usize = 4;

/// Places and weights, on either side of zero, of Gauss's rule at eight places: exact to degree 15, where a term times a product
/// of two shadings has 12.
const NODES: [[f64; 2]; 4] = [
    [0.183_434_642_495_649_8, 0.362_683_783_378_362],
    [0.525_532_409_916_329, 0.313_706_645_877_887_3],
    [0.796_666_477_413_626_7, 0.222_381_034_453_374_5],
    [0.960_289_856_497_536_3, 0.101_228_536_290_376_3],
];

/// A smooth factor on I2: a polynomial of fourth degree in the place on I2, 1 on average.
///
/// Not the paper's, whose exposures are equal. A lens vignettes differently at two focus settings, a lamp moves with the stage, and
/// what is darker towards one side is else taken for motion or blur there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shading {
    /// Of products of Legendre polynomials P_i(x) P_j(y), the place from -1 to 1 along either side, in the order x, y, xx, xy, yy,
    /// xxx, ...; that of the constant term is 1 and left out.
    pub coefficients: [f64; Shading::TERMS],
}

impl Shading {
    /// Coefficients.
    pub const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2 - 1;
    /// The same everywhere.
    pub const NONE: Self = Self { coefficients: [0.0; Self::TERMS] };

    /// The factor at a place, -1 to 1 along either side; from 1/4 to 4.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        let terms = terms(place);
        let sum: f64 = self.coefficients.iter().zip(&terms[1..]).map(|(c, term)| c * term).sum();
        (1.0 + sum).clamp(0.25, 4.0)
    }

    /// The factors of a row at y, -1 to 1, as [`at`](Self::at) has them but for rounding: there a polynomial of x alone.
    pub(crate) fn along(&self, y: f64) -> impl Fn(f64) -> f64 + use<> {
        let py = legendre(y);
        let mut a = [0.0; DEGREE + 1];
        for (c, (i, j)) in std::iter::once(&1.0).chain(&self.coefficients).zip(degrees()) {
            a[i] += c * py[j];
        }
        // Of Legendre's polynomials, by powers of x.
        let powers =
            [a[0] - 0.5 * a[2] + 0.375 * a[4], a[1] - 1.5 * a[3], 1.5 * a[2] - 3.75 * a[4], 2.5 * a[3], 4.375 * a[4]];
        move |x| powers.iter().rev().fold(0.0, |sum, power| sum * x + power).clamp(0.25, 4.0)
    }

    /// The mean of a smooth function of the place, -1 to 1 along either side, and the shading that times it is next to the
    /// function by least squares; no shading where the mean is not positive.
    pub fn fit(of: impl Fn([f64; 2]) -> f64) -> (f64, Self) {
        let nodes = || NODES.iter().flat_map(|&[x, weight]| [[x, weight], [-x, weight]]);
        let mut sums = [0.0; Self::TERMS + 1];
        for [y, down] in nodes() {
            for [x, across] in nodes() {
                let share = 0.25 * across * down * of([x, y]);
                let terms = terms([x, y]);
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += share * term);
            }
        }
        let mean = sums[0];
        if mean <= 0.0 {
            return (mean, Self::NONE);
        }
        // The mean square of P_i is 1/(2i + 1).
        let norms = degrees().map(|(i, j)| ((2 * i + 1) * (2 * j + 1)) as f64);
        let coefficients: Vec<f64> = sums.iter().zip(norms).skip(1).map(|(sum, norm)| sum * norm / mean).collect();
        (mean, Self { coefficients: std::array::from_fn(|n| coefficients[n]) })
    }

    /// Least and greatest factor over the photograph.
    pub fn range(&self) -> [f64; 2] {
        let steps = || (-16..=16).map(|i| f64::from(i) / 16.0);
        let all = steps().flat_map(|y| steps().map(move |x| [x, y]));
        all.map(|place| self.at(place)).fold([f64::INFINITY, 0.0], |[low, high], f| [low.min(f), high.max(f)])
    }
}

/// Each term of the polynomial at a place, the constant one first.
pub(crate) fn terms(place: [f64; 2]) -> [f64; Shading::TERMS + 1] {
    let [px, py] = place.map(legendre);
    let mut terms = [0.0; Shading::TERMS + 1];
    for (term, (i, j)) in terms.iter_mut().zip(degrees()) {
        *term = px[i] * py[j];
    }
    terms
}

/// Along x and y, of each term.
fn degrees() -> impl Iterator<Item = (usize, usize)> {
    (0..=DEGREE).flat_map(|sum| (0..=sum).map(move |j| (sum - j, j)))
}

/// Of degree 0 to 4.
fn legendre(x: f64) -> [f64; DEGREE + 1] {
    let s = x * x;
    [1.0, x, 1.5 * s - 0.5, (2.5 * s - 1.5) * x, (4.375 * s - 3.75) * s + 0.375]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_are_orthogonal_and_average_to_nothing() {
        let steps = || (0..200).map(|i| (f64::from(i) + 0.5) / 100.0 - 1.0);
        for i in 0..=Shading::TERMS {
            for j in 0..i {
                let all = steps().flat_map(|y| steps().map(move |x| terms([x, y])));
                let mean = all.map(|t| t[i] * t[j]).sum::<f64>() / 4e4;
                // By the midpoint rule at 200 places a side.
                assert!(mean.abs() < 1e-3, "{i}, {j}: {mean}");
            }
        }
    }

    #[test]
    fn a_shading_is_fitted_by_itself_and_its_mean() {
        let shading = Shading { coefficients: std::array::from_fn(|n| 0.02 * (1.7 * n as f64).sin()) };
        let (mean, found) = Shading::fit(|place| 1.5 * shading.at(place));
        assert!((mean - 1.5).abs() < 1e-12);
        for (found, expected) in found.coefficients.iter().zip(shading.coefficients) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn a_row_has_the_factors_of_its_places() {
        let shading = Shading { coefficients: std::array::from_fn(|n| 0.1 * (1.7 * n as f64).sin()) };
        for (x, y) in [(-1.0, 0.3), (-0.4, -1.0), (0.0, 0.0), (0.7, 0.9), (1.0, 1.0)] {
            assert!((shading.along(y)(x) - shading.at([x, y])).abs() < 1e-12, "{x} {y}");
        }
    }

    #[test]
    fn a_ramp_ranges_from_side_to_side() {
        let mut ramp = Shading::NONE;
        ramp.coefficients[0] = 0.1;
        assert_eq!(ramp.range(), [0.9, 1.1]);
        assert_eq!(Shading::NONE.range(), [1.0, 1.0]);
    }
}
