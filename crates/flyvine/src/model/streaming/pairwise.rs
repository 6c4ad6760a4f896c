//! Sums in a fixed order, whoever computes which part.
//!
//! Rounded sums depend on their order. Terms are numbered, and always summed as a binary tree over their numbers:
//! terms 0 and 1, 2 and 3, …; then the pairs, and so on. A range of terms is held as the sums of the tree's largest
//! complete subtrees in it, at most two per level; ranges that meet are joined to the very same tree. The error grows
//! with the tree's height, log₂ of the number of terms (Higham, "Accuracy and Stability of Numerical Algorithms",
//! Sec. 4.2).

use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Sum of two parts, the one with smaller numbers first.
pub(crate) trait Merge {
    fn merge(self, later: Self) -> Self;
}

/// Sum of the terms with numbers `start .. end`; numbers may have no term.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PairwiseSum<T> {
    start: usize,
    end: usize,
    /// Complete subtrees, ascending.
    nodes: Vec<Node<T>>,
}

/// Sum of the terms `first .. first + 2^level`; `first` is a multiple of 2^level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Node<T> {
    level: u32,
    first: usize,
    sum: T,
}

impl<T: Merge> PairwiseSum<T> {
    /// No terms, beginning with number `start`.
    pub fn new(start: usize) -> Self {
        Self {
            start,
            end: start,
            nodes: Vec::new(),
        }
    }

    /// Takes the next number's term, if it has one.
    pub fn push(&mut self, term: Option<T>) {
        if let Some(sum) = term {
            self.nodes.push(Node {
                level: 0,
                first: self.end,
                sum,
            });
        }
        self.end += 1;
        self.complete();
    }

    /// Numbers up to `end` have no term.
    pub fn skip_to(&mut self, end: usize) {
        while self.end < end {
            self.push(None);
        }
    }

    /// Takes the range that begins where this one ends; `false` if it begins elsewhere.
    pub fn append(&mut self, later: Self) -> bool {
        if later.start != self.end {
            return false;
        }
        // Subtrees of the later range complete others when all numbers below their end are there.
        for node in later.nodes {
            self.skip_to(node.first);
            self.end = node.first + (1 << node.level);
            self.nodes.push(node);
            self.complete();
        }
        self.skip_to(later.end);
        true
    }

    /// The sum of a range that begins with 0; `None` without a term.
    pub fn total(mut self) -> Option<T> {
        self.skip_to(self.end.next_power_of_two());
        self.nodes.pop().map(|node| node.sum)
    }

    /// Joins the subtrees that end with the newest number.
    fn complete(&mut self) {
        for level in 1..=self.end.trailing_zeros().min(usize::BITS - 1) {
            let Some(first) = self
                .end
                .checked_sub(1 << level)
                .filter(|first| *first >= self.start)
            else {
                return;
            };
            let inside = self
                .nodes
                .iter()
                .rev()
                .take_while(|node| node.first >= first)
                .count();
            let Some(last) = self.nodes.pop_if(|_| inside > 0) else {
                continue;
            };
            let sum = match self.nodes.pop_if(|_| inside > 1) {
                Some(earlier) => earlier.sum.merge(last.sum),
                None => last.sum,
            };
            self.nodes.push(Node { level, first, sum });
        }
    }

    /// Whether this is a sum of terms of `range`: for one that was read.
    pub fn is_within(&self, range: Range<usize>) -> bool {
        let mut free = self.start;
        for node in &self.nodes {
            let aligned = node.level < usize::BITS && node.first.is_multiple_of(1 << node.level);
            let end = node.first.checked_add(1_usize.wrapping_shl(node.level));
            match end {
                Some(end) if aligned && node.first >= free && end <= self.end => free = end,
                _ => return false,
            }
        }
        range.start <= self.start && self.start <= self.end && self.end <= range.end
    }

    /// What the subtrees hold.
    pub fn parts(&self) -> impl Iterator<Item = &T> {
        self.nodes.iter().map(|node| &node.sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Which sums were made, as brackets.
    impl Merge for String {
        fn merge(self, later: Self) -> Self {
            format!("({self}{later})")
        }
    }

    fn sum(terms: &[bool], range: Range<usize>) -> PairwiseSum<String> {
        let mut sum = PairwiseSum::new(range.start);
        for number in range {
            sum.push(terms[number].then(|| format!("{number} ")));
        }
        sum
    }

    #[test]
    fn five_terms_are_two_pairs_and_one() {
        let whole = sum(&[true; 5], 0..5);
        assert_eq!(whole.parts().count(), 2);
        assert_eq!(whole.total().unwrap(), "(((0 1 )(2 3 ))4 )");
        assert_eq!(sum(&[false; 3], 0..3).total(), None);
    }

    proptest! {
        #[test]
        fn ranges_join_to_the_same_tree(terms in prop::collection::vec(prop::bool::weighted(0.7), 1..70),
                                        cuts in prop::collection::vec(0.0..1.0_f64, 0..5)) {
            let mut bounds: Vec<usize> = cuts.iter().map(|cut| (cut * terms.len() as f64) as usize).collect();
            bounds.extend([0, terms.len()]);
            bounds.sort_unstable();
            let mut joined = PairwiseSum::new(0);
            for pair in bounds.windows(2) {
                prop_assert!(joined.append(sum(&terms, pair[0]..pair[1])));
            }
            let whole = sum(&terms, 0..terms.len());
            prop_assert!(whole.parts().count() <= 2 * (terms.len().ilog2() as usize + 1));
            prop_assert_eq!(&joined, &whole);
            prop_assert!(joined.is_within(0..terms.len()));
            prop_assert_eq!(joined.total(), whole.total());
        }
    }
}
