//! What must be in order before a flight: what was found, what is expected, and why it matters.

use std::fmt;

/// Whether an item that is not in order forbids the flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weight {
    /// No flight without it.
    Blocking,
    /// The flight is the operator's decision.
    Warning,
}

/// One item.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// What is checked.
    pub name: String,
    /// Whether it is in order.
    pub good: bool,
    /// What was found.
    pub found: String,
    /// What is expected.
    pub expected: String,
    /// Whether it forbids the flight.
    pub weight: Weight,
    /// Why it matters.
    pub why: &'static str,
}

/// All items, in the order in which they were checked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checklist {
    /// The items.
    pub items: Vec<Item>,
}

impl Checklist {
    /// Adds an item that forbids the flight unless `good`.
    pub fn must(
        &mut self,
        name: &str,
        good: bool,
        found: impl Into<String>,
        expected: impl Into<String>,
        why: &'static str,
    ) {
        self.items.push(Item {
            name: name.to_owned(),
            good,
            found: found.into(),
            expected: expected.into(),
            weight: Weight::Blocking,
            why,
        });
    }

    /// Whether nothing forbids the flight.
    pub fn is_ready(&self) -> bool {
        self.missing(Weight::Blocking).next().is_none()
    }

    /// The items of one weight that are not in order.
    pub fn missing(&self, weight: Weight) -> impl Iterator<Item = &Item> {
        self.items
            .iter()
            .filter(move |item| !item.good && item.weight == weight)
    }
}

impl fmt::Display for Item {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, found, .. } = self;
        match (self.good, self.weight) {
            (true, _) => write!(f, "ok       {name}: {found}"),
            (false, Weight::Blocking) => write!(
                f,
                "MISSING  {name}: found {found}; expected {}. {}",
                self.expected, self.why
            ),
            (false, Weight::Warning) => write!(
                f,
                "warning  {name}: found {found}; expected {}. {}",
                self.expected, self.why
            ),
        }
    }
}

impl fmt::Display for Checklist {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, item) in self.items.iter().enumerate() {
            if i > 0 {
                writeln!(f)?;
            }
            write!(f, "{item}")?;
        }
        Ok(())
    }
}
