//! A CSV file as a header and rows of cells, with the place of every cell for error messages.

use std::io::Read;

use super::error::{FlightError, Problem};

/// A CSV file; every row has as many cells as the header.
pub(super) struct Table {
    /// The file's name, for messages.
    file: String,
    header: Vec<String>,
    rows: Vec<Row>,
}

/// One data row.
pub(super) struct Row {
    /// Line in the file, counted from 1.
    pub line: u64,
    cells: ::csv::StringRecord,
}

/// A column that exists exactly once.
#[derive(Clone, Copy)]
pub(super) struct Column(usize);

impl Table {
    /// Reads all of `input`; cells are trimmed.
    pub fn read(file: &str, input: impl Read, delimiter: u8) -> Result<Table, FlightError> {
        let mut reader = ::csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(delimiter)
            .trim(::csv::Trim::All)
            .from_reader(input);
        let mut records = reader
            .records()
            .map(|record| record.map_err(|e| csv_error(file, e)));
        let header = records
            .next()
            .ok_or_else(|| FlightError::in_file(file, Problem::Empty))??;
        // Some spreadsheet programs begin a file with a byte order mark.
        let header: Vec<String> = header
            .iter()
            .map(|name| name.trim_start_matches('\u{feff}').to_owned())
            .collect();
        let mut rows = Vec::new();
        for record in records {
            let cells = record?;
            let line = cells.position().map_or(0, ::csv::Position::line);
            if cells.len() != header.len() {
                let problem = Problem::CellCount {
                    found: cells.len(),
                    expected: header.len(),
                };
                return Err(FlightError::in_line(file, line, problem));
            }
            rows.push(Row { line, cells });
        }
        if rows.is_empty() {
            return Err(FlightError::in_file(file, Problem::NoRows));
        }
        Ok(Table {
            file: file.to_owned(),
            header,
            rows,
        })
    }

    /// The rows, at least one.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Whether the header has `name`.
    pub fn has(&self, name: &str) -> bool {
        self.header.iter().any(|column| column == name)
    }

    /// The column called `name`; it must occur exactly once.
    pub fn column(&self, name: &str) -> Result<Column, FlightError> {
        let mut found = (0..self.header.len()).filter(|&i| self.header[i] == name);
        let problem = match (found.next(), found.count()) {
            (Some(index), 0) => return Ok(Column(index)),
            (Some(_), others) => Problem::DuplicateColumn { count: others + 1 },
            (None, _) => Problem::MissingColumn {
                available: self.header.clone(),
            },
        };
        Err(FlightError::in_line(&self.file, 1, problem).field(name))
    }

    /// Several columns at once.
    pub fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[Column; N], FlightError> {
        let mut columns = [Column(0); N];
        for (column, name) in columns.iter_mut().zip(names) {
            *column = self.column(name)?;
        }
        Ok(columns)
    }

    /// The text of one cell, without surrounding blanks.
    pub fn text<'a>(&self, row: &'a Row, column: Column) -> &'a str {
        &row.cells[column.0]
    }

    /// The number in one cell, `None` where the cell is empty. It may be NaN or infinite.
    pub fn number(&self, row: &Row, column: Column) -> Result<Option<f64>, FlightError> {
        match self.text(row, column) {
            "" => Ok(None),
            text => text.parse().map(Some).map_err(|_| {
                let found = text.chars().take(40).collect();
                self.error(row, column, Problem::NotANumber { found })
            }),
        }
    }

    /// An error at one cell.
    pub fn error(&self, row: &Row, column: Column, problem: Problem) -> FlightError {
        FlightError::in_line(&self.file, row.line, problem).field(&self.header[column.0])
    }
}

fn csv_error(file: &str, error: ::csv::Error) -> FlightError {
    let line = error.position().map(::csv::Position::line);
    let problem = match error.into_kind() {
        ::csv::ErrorKind::Io(error) => Problem::Io(error),
        // Without `has_headers` and with `flexible` rows, nothing else is left to go wrong.
        _ => Problem::NotText,
    };
    let mut error = FlightError::in_file(file, problem);
    error.place.line = line;
    error
}
