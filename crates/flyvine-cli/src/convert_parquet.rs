//! Flights as Parquet tables: the columns of the CSV format, as doubles; a pose that motion capture missed is null.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use flyvine::flight::{COLUMNS, Flight, Sample, VELOCITY_COLUMNS, columns_of, parse_csv};
use parquet::basic::{Repetition, Type as Physical};
use parquet::data_type::DoubleType;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::types::Type;

/// One row's cells, in the order of [`COLUMNS`] and [`VELOCITY_COLUMNS`].
fn cells(sample: &Sample) -> Vec<Option<f64>> {
    let configuration = sample.configuration;
    let mut cells = vec![
        Some(sample.t_s),
        Some(configuration.length_m),
        Some(configuration.pressure_kpa),
    ];
    let mut part = |numbers: Option<Vec<f64>>, count: usize| match numbers {
        Some(numbers) => cells.extend(numbers.into_iter().map(Some)),
        None => cells.extend(std::iter::repeat_n(None, count)),
    };
    part(Some(sample.command.to_vec()), 3);
    part(
        sample
            .quadrotor
            .map(|pose| [&pose.position[..], &pose.attitude].concat()),
        7,
    );
    part(sample.end_effector.map(|tip| tip.to_vec()), 3);
    part(sample.command_velocity.map(|velocity| velocity.to_vec()), 3);
    cells
}

/// Writes `flight` as a Parquet file, whole or not at all.
pub fn write_parquet(path: &Path, flight: &Flight) -> Result<()> {
    let rows: Vec<_> = flight.samples.iter().map(cells).collect();
    let columns = columns_of(flight);
    let field = |name: &&str| {
        let builder = Type::primitive_type_builder(name, Physical::DOUBLE);
        builder
            .with_repetition(Repetition::OPTIONAL)
            .build()
            .map(Arc::new)
    };
    let fields = columns.iter().map(field).collect::<Result<Vec<_>, _>>()?;
    let schema = Arc::new(Type::group_type_builder("flight").with_fields(fields).build()?);
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(WriterProperties::default()))?;
    let mut group = writer.next_row_group()?;
    for index in 0..columns.len() {
        let present: Vec<f64> = rows.iter().filter_map(|row| row[index]).collect();
        let levels: Vec<i16> = rows.iter().map(|row| i16::from(row[index].is_some())).collect();
        let mut column = group.next_column()?.context("the schema has as many columns")?;
        column
            .typed::<DoubleType>()
            .write_batch(&present, Some(&levels), None)?;
        column.close()?;
    }
    group.close()?;
    flyvine::file::write_whole(path, &writer.into_inner()?).with_context(|| path.display().to_string())
}

/// Reads a flight from a Parquet file of whatever origin: numeric columns with the names of the CSV format, in any order,
/// further ones ignored. It is checked as a CSV file is, and errors name the lines that it would have there.
pub fn read_parquet(path: &Path) -> Result<Flight> {
    let shown = path.display().to_string();
    let file = File::open(path).with_context(|| shown.clone())?;
    let reader = SerializedFileReader::new(file).with_context(|| shown.clone())?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let names: Vec<&str> = schema.columns().iter().map(|column| column.name()).collect();
    let known = COLUMNS.into_iter().chain(VELOCITY_COLUMNS);
    let wanted: Vec<&str> = known.filter(|name| names.contains(name)).collect();
    let mut text = wanted.join(",") + "\n";
    for row in reader.get_row_iter(None).with_context(|| shown.clone())? {
        let row = row.with_context(|| shown.clone())?;
        let found: BTreeMap<&str, &Field> = row
            .get_column_iter()
            .map(|(name, field)| (name.as_str(), field))
            .collect();
        let cells: Result<Vec<String>> = wanted
            .iter()
            .map(|name| cell(found[name]).with_context(|| format!("{shown}: column {name}")))
            .collect();
        text += &(cells?.join(",") + "\n");
    }
    Ok(parse_csv(&shown, text.as_bytes())?)
}

/// A number as CSV has it.
fn cell(field: &Field) -> Result<String> {
    Ok(match field {
        Field::Null => String::new(),
        Field::Double(number) => number.to_string(),
        Field::Float(number) => f64::from(*number).to_string(),
        Field::Int(number) => number.to_string(),
        Field::Long(number) => number.to_string(),
        other => bail!("found {other}, expected a number"),
    })
}
