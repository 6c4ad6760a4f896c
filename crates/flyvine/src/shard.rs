//! Work that several processes share.

use std::ops::Range;

/// Part `number` of `of` equal parts of some work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    pub number: usize,
    /// Number of parts.
    pub of: usize,
}

impl Shard {
    /// Everything.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Its items among `count`, when each part is one stretch.
    pub fn range(self, count: usize) -> Range<usize> {
        count * (self.number - 1) / self.of..count * self.number / self.of
    }

    /// Its items among `count`, when parts take turns.
    pub fn indices(self, count: usize) -> impl Iterator<Item = usize> {
        (self.number - 1..count).step_by(self.of)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/');
        let shard = parts.and_then(|(number, of)| {
            Some(Self {
                number: number.parse().ok()?,
                of: of.parse().ok()?,
            })
        });
        shard
            .filter(|shard| (1..=shard.of).contains(&shard.number))
            .ok_or_else(|| format!("found `{text}`, expected i/n with 1 ≤ i ≤ n, as 3/8"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_make_the_whole_without_overlap() {
        let shards = || (1..=3).map(|number| Shard { number, of: 3 });
        let mut rows: Vec<usize> = shards().flat_map(|shard| shard.indices(11)).collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..11).collect::<Vec<_>>());
        let stretches: Vec<usize> = shards().flat_map(|shard| shard.range(11)).collect();
        assert_eq!(stretches, (0..11).collect::<Vec<_>>());
    }

    #[test]
    fn a_shard_is_one_of_its_count() {
        assert_eq!("3/8".parse(), Ok(Shard { number: 3, of: 8 }));
        for wrong in ["0/8", "9/8", "3", "a/b", "1/0", "-1/2"] {
            let error = wrong.parse::<Shard>().unwrap_err();
            assert!(error.contains(wrong) && error.contains("expected i/n"), "{error}");
        }
    }
}
