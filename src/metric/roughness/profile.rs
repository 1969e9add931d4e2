//! Profile parameters of ISO 21920-2: Ra, Rq and Rz of profiles with missing samples.

use super::areal::{Surface, mean};
use super::filter::Filters;

/// The number of section lengths of a profile without an L-filter (the default of ISO 21920-3).
const SECTIONS: usize = 5;
/// The least share of measured samples of a profile.
const LEAST_MEASURED: f64 = 0.5;
/// The smallest number of measured samples of a profile.
pub(super) const LEAST_SAMPLES: usize = 16;

/// Means of the parameters of profiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProfileParameters {
    /// Arithmetic mean deviation.
    pub(super) ra: f64,
    /// Root mean square deviation.
    pub(super) rq: f64,
    /// Mean over the section lengths of the height from the deepest pit to the highest peak.
    pub(super) rz: f64,
    /// The number of profiles with enough measured samples.
    pub(super) profiles: usize,
}

impl ProfileParameters {
    /// Evaluates each row of a surface whose form has been removed. Filters are those of profiles, along the rows.
    pub(super) fn of_rows(surface: &Surface, filters: &Filters) -> Self {
        Self::of(surface.values.chunks_exact(surface.width), filters)
    }

    /// Evaluates one profile.
    pub(super) fn of_profile(heights: &[f64], filters: &Filters) -> Self {
        Self::of(std::iter::once(heights), filters)
    }

    fn of<'a>(profiles: impl Iterator<Item = &'a [f64]>, filters: &Filters) -> Self {
        let all: Vec<[f64; 3]> = profiles.filter_map(|heights| evaluate(heights, filters)).collect();
        let [ra, rq, rz] = [0, 1, 2].map(|n| mean(all.iter().map(|parameters| parameters[n])));
        Self { ra, rq, rz, profiles: all.len() }
    }
}

/// Returns the number of section lengths in a profile of this length, px: one for each cutoff of the L-filter.
pub(super) fn sections(length: usize, cutoff: Option<f64>) -> usize {
    cutoff.map_or(SECTIONS, |cutoff| (length as f64 / cutoff) as usize).max(1)
}

/// Returns Ra, Rq and Rz. `None` if too few samples are measured.
fn evaluate(heights: &[f64], filters: &Filters) -> Option<[f64; 3]> {
    let measured = heights.iter().filter(|z| z.is_finite()).count();
    if measured < LEAST_SAMPLES || (measured as f64) < LEAST_MEASURED * heights.len() as f64 {
        return None;
    }
    let profile = filters.apply(Surface { width: heights.len(), values: heights.to_vec() });
    let level = profile.mean();
    let heights: Vec<f64> = profile.values.iter().map(|z| z - level).collect();
    let ra = mean(heights.iter().map(|z| z.abs()));
    let rq = mean(heights.iter().map(|z| z * z)).sqrt();
    let count = sections(heights.len(), filters.l_cutoff);
    let bounds = |n: usize| n * heights.len() / count;
    let total = |n: usize| {
        let finite = || heights[bounds(n)..bounds(n + 1)].iter().copied().filter(|z| z.is_finite());
        finite().fold(f64::NAN, f64::max) - finite().fold(f64::NAN, f64::min)
    };
    Some([ra, rq, mean((0..count).map(total))])
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::super::areal::tests::{close, surface};
    use super::*;

    #[test]
    fn rows_of_a_sine_have_its_closed_forms() {
        let none = Filters::default();
        let mut sine = surface([1000, 4], |x, y| 2.0 * (TAU * (x + 0.5) / 100.0).sin() + 10.0 * y);
        let found = ProfileParameters::of_rows(&sine, &none);
        close(found.ra, 4.0 / PI, 1e-3);
        close(found.rq, 2f64.sqrt(), 1e-9);
        close(found.rz, 4.0, 1e-3);
        assert_eq!(found.profiles, 4);
        // A row with too few samples does not count.
        sine.values[..600].fill(f64::NAN);
        assert_eq!(ProfileParameters::of_rows(&sine, &none).profiles, 3);
        // A peak in one of five sections counts a fifth.
        sine.values[1007] += 100.0;
        let peak = ProfileParameters::of_profile(&sine.values[1000..2000], &none);
        assert!((20.0..25.0).contains(&peak.rz), "{peak:?}");
    }

    #[test]
    fn the_l_filter_leaves_half_at_its_cutoff_and_sets_the_sections() {
        let sine = surface([2000, 1], |x, _| (TAU * x / 100.0).sin());
        let found = ProfileParameters::of_rows(&sine, &Filters::new(None, Some(100.0)));
        close(found.rq, 0.5 / 2f64.sqrt(), 0.02);
        assert_eq!((sections(2000, Some(100.0)), sections(90, Some(100.0)), sections(90, None)), (20, 1, 5));
    }
}
