//! Order statistics of a field.

/// Valid values of a field, of which ranks are asked.
pub(crate) struct Ranks(Vec<f32>);

impl Ranks {
    /// The values that are finite.
    pub(crate) fn of(values: &[f32]) -> Self {
        Self(values.iter().copied().filter(|v| v.is_finite()).collect())
    }

    /// The quantile `q` in [0, 1], linear between ranks (0 is the least value, ½ the median); `None` if no value is valid.
    pub(crate) fn quantile(&mut self, q: f64) -> Option<f32> {
        let last = self.0.len().checked_sub(1)?;
        let rank = q * last as f64;
        let (_, &mut low, above) = self.0.select_nth_unstable_by(rank as usize, f32::total_cmp);
        let high = above.iter().copied().fold(f32::INFINITY, f32::min);
        let fraction = rank.fract();
        // Past the last rank there is nothing above, and the fraction is 0.
        Some(if fraction == 0.0 {
            low
        } else {
            (f64::from(low) * (1.0 - fraction) + f64::from(high) * fraction) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_and_leave_out_what_is_not_valid() {
        let mut ranks = Ranks::of(&[4.0, f32::NAN, 1.0, 3.0, 2.0, f32::INFINITY]);
        assert_eq!(ranks.quantile(0.0), Some(1.0));
        assert_eq!(ranks.quantile(0.5), Some(2.5));
        assert_eq!(ranks.quantile(1.0), Some(4.0));
        assert_eq!(ranks.quantile(1.0 / 3.0), Some(2.0));
    }

    #[test]
    fn one_percent_of_a_hundred_and_one_is_the_second() {
        let values: Vec<f32> = (0..101).rev().map(|i| i as f32).collect();
        let mut ranks = Ranks::of(&values);
        assert_eq!(ranks.quantile(0.01), Some(1.0));
        assert_eq!(ranks.quantile(0.99), Some(99.0));
    }

    #[test]
    fn no_valid_value_has_no_rank() {
        assert_eq!(Ranks::of(&[f32::NAN]).quantile(0.5), None);
        assert_eq!(Ranks::of(&[7.0]).quantile(0.5), Some(7.0));
    }
}
