//! Weighted sums of rows of numbers: what a filter along an axis is.

use std::ops::{AddAssign, Mul};

/// Sums that stay in a processor's registers while all terms are added: a row at a time, each term goes to memory and back, and filters take
/// 1.4 to 2 times as long; by 8 or 32 at once they do too.
const AT_ONCE: usize = 16;

/// Sets each sum to `Σ weights[n] rows[n][i]`, added in the order of n. Rows may be longer.
pub(crate) fn sum<T>(sums: &mut [T], weights: &[T], rows: &[&[T]])
where
    T: Copy + Default + AddAssign + Mul<Output = T>,
{
    let (blocks, rest) = sums.as_chunks_mut::<AT_ONCE>();
    let (mut first, beyond) = (0, blocks.len() * AT_ONCE);
    for block in blocks {
        *block = at(first, weights, rows);
        first += AT_ONCE;
    }
    for (i, sum) in rest.iter_mut().enumerate() {
        [*sum] = at(beyond + i, weights, rows);
    }
}

/// So many sums from the i-th on.
fn at<T, const COUNT: usize>(i: usize, weights: &[T], rows: &[&[T]]) -> [T; COUNT]
where
    T: Copy + Default + AddAssign + Mul<Output = T>,
{
    let mut sums = [T::default(); COUNT];
    for (&weight, row) in weights.iter().zip(rows) {
        let values = &row[i..][..COUNT];
        (0..COUNT).for_each(|k| sums[k] += weight * values[k]);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_any_number_are_those_of_each() {
        let rows: Vec<Vec<f32>> =
            (0..5).map(|n| (0..50).map(|i| ((7 * n + 3 * i) % 11) as f32 - 4.3).collect()).collect();
        let rows: Vec<&[f32]> = rows.iter().map(Vec::as_slice).collect();
        let weights = [0.1, -0.7, 0.3, 1.9, -0.2];
        for count in [0, 1, 15, 16, 17, 48, 50] {
            let mut sums = vec![9.0; count];
            sum(&mut sums, &weights, &rows);
            for (i, sum) in sums.into_iter().enumerate() {
                let expected = weights.iter().zip(&rows).fold(0.0, |sum, (weight, row)| sum + weight * row[i]);
                assert_eq!(sum, expected, "{i} of {count}");
            }
        }
    }
}
