//! Which key-point of I2 is which of I1.

use super::sift::{Descriptor, Features};

/// A match is kept if its distance is less than this much of that to the second nearest (Lowe 2004, section 7.1).
const RATIO: f64 = 0.8;

/// A place in I1 and the same in I2, pixels.
pub(super) type Match = [[f64; 2]; 2];

/// The nearest and the second nearest so far.
#[derive(Clone, Copy)]
struct Nearest {
    index: usize,
    squared: i32,
    second: i32,
}

impl Nearest {
    const NONE: Self = Self { index: usize::MAX, squared: i32::MAX, second: i32::MAX };

    fn see(&mut self, index: usize, squared: i32) {
        if squared < self.squared {
            *self = Self { index, squared, second: self.squared };
        } else {
            self.second = self.second.min(squared);
        }
    }

    fn is_distinct(&self) -> bool {
        f64::from(self.squared) < RATIO * RATIO * f64::from(self.second)
    }
}

/// The pairs that are each other's nearest and pass the ratio test in I2. Compares all with all.
///
/// A place that matches under several orientations counts as often: counted once, five of six real pairs came out further
/// from another program's estimate.
pub(super) fn matches(a: &Features, b: &Features) -> Vec<Match> {
    let mut of_a = vec![Nearest::NONE; a.descriptors.len()];
    let mut of_b = vec![Nearest::NONE; b.descriptors.len()];
    for (i, (da, of_a)) in a.descriptors.iter().zip(&mut of_a).enumerate() {
        for (j, (db, of_b)) in b.descriptors.iter().zip(&mut of_b).enumerate() {
            let squared = squared_distance(da, db);
            of_a.see(j, squared);
            of_b.see(i, squared);
        }
    }
    let mutual = of_a.iter().enumerate().filter(|(i, n)| n.is_distinct() && of_b[n.index].index == *i);
    mutual.map(|(i, n)| [a.places[i], b.places[n.index]]).collect()
}

/// Of two descriptors whose numbers are at most 255, so that neither a difference nor the sum overflows.
fn squared_distance(a: &Descriptor, b: &Descriptor) -> i32 {
    a.iter().zip(b).map(|(a, b)| i32::from(a - b) * i32::from(a - b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(values: &[i16]) -> Features {
        Features {
            places: (0..values.len()).map(|i| [i as f64, 0.0]).collect(),
            descriptors: values.iter().map(|&v| [v; 128]).collect(),
        }
    }

    #[test]
    fn matches_are_mutual_and_distinct() {
        let a = features(&[10, 100, 201, 203]);
        // 12 is the first's; 98 and 102 are equally near to the second; 202 is near to two, one of them is its own.
        let found = matches(&a, &features(&[98, 102, 12, 202]));
        assert_eq!(found, [[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.0], [3.0, 0.0]]]);
        assert_eq!(squared_distance(&[255; 128], &[0; 128]), 128 * 255 * 255);
    }

    #[test]
    fn nothing_matches_nothing() {
        assert!(matches(&features(&[]), &features(&[1])).is_empty());
        assert!(matches(&features(&[1]), &features(&[])).is_empty());
    }
}
