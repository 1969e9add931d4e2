//! A share of a batch, for several processes or machines.

use std::str::FromStr;

/// One of so many shares.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shard {
    /// From 1.
    index: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            _ => Err("give I/N, the I-th of N shares, as in 2/8".to_string()),
        }
    }
}

impl Shard {
    /// All.
    pub(crate) const WHOLE: Self = Self { index: 1, count: 1 };

    /// Its own of all: of three shares the first, the fourth, the seventh, ... for the first.
    pub(crate) fn of<T>(self, all: Vec<T>) -> impl Iterator<Item = T> {
        all.into_iter().skip(self.index - 1).step_by(self.count)
    }

    /// The file that says what came of it.
    pub(crate) fn summary(self) -> String {
        format!("batch-{}-of-{}.json", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_apart_and_together_all() {
        let share = |text: &str| text.parse::<Shard>().unwrap().of((0..7).collect()).collect::<Vec<_>>();
        assert_eq!([share("1/3"), share("2/3"), share("3/3")], [vec![0, 3, 6], vec![1, 4], vec![2, 5]]);
        assert_eq!((share("1/1").len(), share("8/9").len()), (7, 0));
        for text in ["0/3", "4/3", "x", "1/", "/2", "1/2/3", "-1/3", "1.5/2"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
