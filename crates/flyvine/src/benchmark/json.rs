//! Walking a JSON document with errors that name the place, what was found and what was expected.

use serde_json::Value;
use std::path::PathBuf;

/// Why a problem file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BenchmarkError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The text is not JSON (which knows no NaN or infinity).
    #[error("not JSON: {0}")]
    Syntax(#[from] serde_json::Error),
    /// A key is missing.
    #[error("{place}: missing, expected {expected}")]
    Missing {
        /// Path of the key.
        place: String,
        /// What should be there.
        expected: String,
    },
    /// A value has the wrong type or size.
    #[error("{place}: found {found}, expected {expected}")]
    Unexpected {
        /// Path of the value.
        place: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
    },
    /// The numbers do not make a valid model.
    #[error(transparent)]
    Model(#[from] crate::model::ModelError),
    /// The numbers do not make a condensed MPC problem.
    #[error(transparent)]
    Condensed(#[from] crate::control::mpc::CondensedError),
    /// The numbers do not make a valid problem.
    #[error(transparent)]
    Problem(#[from] crate::trajopt::ProblemError),
}

/// A JSON value and its path in the document.
pub struct Node<'a> {
    pub place: String,
    pub value: &'a Value,
}

impl<'a> Node<'a> {
    pub fn root(value: &'a Value) -> Self {
        Self {
            place: String::new(),
            value,
        }
    }

    /// The wrong-value error for this node.
    pub fn unexpected(&self, expected: &str) -> BenchmarkError {
        let found = match self.value {
            Value::Null => "null".to_string(),
            Value::Array(items) => format!("a list of {}", items.len()),
            Value::Object(_) => "an object".to_string(),
            scalar => scalar.to_string(),
        };
        BenchmarkError::Unexpected {
            place: self.place.clone(),
            found,
            expected: expected.to_string(),
        }
    }

    /// The value of a key that must exist.
    pub fn get(&self, key: &str, expected: &str) -> Result<Node<'a>, BenchmarkError> {
        let object = self
            .value
            .as_object()
            .ok_or_else(|| self.unexpected("an object"))?;
        let place = if self.place.is_empty() {
            key.to_string()
        } else {
            format!("{}.{key}", self.place)
        };
        match object.get(key) {
            Some(value) => Ok(Node { place, value }),
            None => Err(BenchmarkError::Missing {
                place,
                expected: expected.to_string(),
            }),
        }
    }

    /// The items of a list.
    pub fn items(&self) -> Result<impl Iterator<Item = Node<'a>> + use<'a, '_>, BenchmarkError> {
        let items = self.value.as_array().ok_or_else(|| self.unexpected("a list"))?;
        Ok(items.iter().enumerate().map(|(i, value)| Node {
            place: format!("{}[{i}]", self.place),
            value,
        }))
    }

    /// A list of exactly `len` items.
    pub fn items_of(
        &self,
        len: usize,
        what: &str,
    ) -> Result<impl Iterator<Item = Node<'a>> + use<'a, '_>, BenchmarkError> {
        if self.value.as_array().is_none_or(|items| items.len() != len) {
            return Err(self.unexpected(&format!("a list of {len} {what}")));
        }
        self.items()
    }

    pub fn number(&self) -> Result<f64, BenchmarkError> {
        self.value
            .as_f64()
            .filter(|number| number.is_finite())
            .ok_or_else(|| self.unexpected("a finite number"))
    }

    pub fn count(&self) -> Result<usize, BenchmarkError> {
        let count = self.value.as_u64().and_then(|count| usize::try_from(count).ok());
        count.ok_or_else(|| self.unexpected("a whole number of at least 0"))
    }

    /// A list of `len` numbers.
    pub fn vector(&self, len: usize) -> Result<Vec<f64>, BenchmarkError> {
        self.items_of(len, "numbers")?.map(|item| item.number()).collect()
    }

    /// A list of `rows` lists of `columns` numbers, row-major.
    pub fn matrix(&self, rows: usize, columns: usize) -> Result<Vec<f64>, BenchmarkError> {
        let items = self.items_of(rows, &format!("rows of {columns} numbers"))?;
        let rows: Vec<_> = items.map(|row| row.vector(columns)).collect::<Result<_, _>>()?;
        Ok(rows.concat())
    }
}
