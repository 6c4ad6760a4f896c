//! The table of a sweep as Parquet.
//!
//! | column | type | |
//! | --- | --- | --- |
//! | `key` | string | hash of everything that determines the row |
//! | `task`, `plan_sha256`, `controller` | string | what was flown, and how |
//! | `seed` | int64 | |
//! | one per varied parameter | double | `wind.mean_m_s.0` is `wind_mean_m_s_0` |
//! | `status`, `cause` | string | `completed`, `aborted` or `refused`, and why |
//! | `success` | boolean | by the sweep's own measure |
//! | `flown_s` | double | vehicle time at the end, s |
//! | `rows`, `rows_missing`, `knots_not_flown` | int32 or null | of the score |
//! | `ee_vs_reference_mean_m`, `…_rms_m`, `…_max_m`, `ee_vs_prediction_…` | double or null | m |
//! | `target_miss_m` | double or null | swings: m |

use std::sync::Arc;

use flyvine::report::Score;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type};
use parquet::errors::Result as ParquetResult;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

use super::row::RowResult;
use super::sweep::{Row, column_name};
use super::{Sweep, SweepError};

/// Rows of a row group: enough for statistics to be worth their room.
const GROUP_ROWS: usize = 100_000;

/// One column's values. The optional ones are empty where a flight has no score.
enum Values {
    Text(Vec<ByteArray>),
    Integer(Vec<i64>),
    Boolean(Vec<bool>),
    Number(Vec<f64>),
    OptionalNumber(Vec<Option<f64>>),
    OptionalCount(Vec<Option<i32>>),
}

struct Column {
    name: String,
    values: Values,
}

/// The table of `rows` (each row's key and result, in the sweep's order) as a Parquet file: the same rows make the same
/// bytes.
///
/// # Errors
/// The table cannot be written.
pub fn parquet_bytes(sweep: &Sweep, rows: &[(String, RowResult)]) -> Result<Vec<u8>, SweepError> {
    let mut indices = (0..rows.len()).collect::<Vec<_>>();
    let mut groups = indices.chunks_mut(GROUP_ROWS);
    // A table without rows has its columns all the same.
    let first = columns(sweep, groups.next().unwrap_or_default(), rows);
    let fields = first
        .iter()
        .map(Column::field)
        .collect::<ParquetResult<Vec<_>>>()?;
    let schema = Arc::new(Type::group_type_builder("sweep").with_fields(fields).build()?);
    let properties = WriterProperties::builder()
        .set_created_by(concat!("flyvine ", env!("CARGO_PKG_VERSION")).to_owned())
        .build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    write_group(&mut writer, &first)?;
    for group in groups {
        write_group(&mut writer, &columns(sweep, group, rows))?;
    }
    Ok(writer.into_inner()?)
}

fn write_group(writer: &mut SerializedFileWriter<Vec<u8>>, columns: &[Column]) -> ParquetResult<()> {
    let mut group = writer.next_row_group()?;
    for column in columns {
        column.write(&mut group)?;
    }
    group.close()?;
    Ok(())
}

fn columns(sweep: &Sweep, indices: &[usize], results: &[(String, RowResult)]) -> Vec<Column> {
    let rows: Vec<Row> = indices.iter().map(|&index| sweep.row(index)).collect();
    let results = &results[indices.first().copied().unwrap_or(0)..][..indices.len()];
    let of_row = |value: &dyn Fn(&Row) -> ByteArray| Values::Text(rows.iter().map(value).collect());
    let of_result = |value: &dyn Fn(&RowResult) -> ByteArray| {
        Values::Text(results.iter().map(|(_, result)| value(result)).collect())
    };
    let number = |value: &dyn Fn(&Score) -> Option<f64>| {
        let values = results.iter().map(|(_, result)| value(result.score.as_ref()?));
        Values::OptionalNumber(values.collect())
    };
    let count = |value: &dyn Fn(&Score) -> usize| {
        let values = results
            .iter()
            .map(|(_, result)| i32::try_from(value(result.score.as_ref()?)).ok());
        Values::OptionalCount(values.collect())
    };
    let keys = results.iter().map(|(key, _)| key.as_str().into());
    let mut columns = vec![
        ("key".to_owned(), Values::Text(keys.collect())),
        (
            "task".to_owned(),
            of_row(&|row| row.plan.task.name.as_str().into()),
        ),
        ("plan_sha256".to_owned(), of_row(&|row| row.plan_sha256.into())),
        ("controller".to_owned(), of_row(&|row| row.law.name().into())),
        (
            "seed".to_owned(),
            Values::Integer(rows.iter().map(|row| row.seed as i64).collect()),
        ),
    ];
    for (place, path) in sweep.parameters().into_iter().enumerate() {
        let values = rows.iter().map(|row| row.values[place]).collect();
        columns.push((column_name(path), Values::Number(values)));
    }
    let success = results
        .iter()
        .map(|(_, result)| result.succeeded(sweep.success()));
    let flown_s = results.iter().map(|(_, result)| result.flown_s);
    columns.extend(
        [
            ("status", of_result(&|result| result.status.name().into())),
            ("cause", of_result(&|result| result.cause.as_str().into())),
            ("success", Values::Boolean(success.collect())),
            ("flown_s", Values::Number(flown_s.collect())),
            ("rows", count(&|score| score.rows)),
            ("rows_missing", count(&|score| score.rows_missing)),
            ("knots_not_flown", count(&|score| score.knots_not_flown)),
            (
                "ee_vs_reference_mean_m",
                number(&|score| Some(score.ee_vs_reference.mean_m)),
            ),
            (
                "ee_vs_reference_rms_m",
                number(&|score| Some(score.ee_vs_reference.rms_m)),
            ),
            (
                "ee_vs_reference_max_m",
                number(&|score| Some(score.ee_vs_reference.max_m)),
            ),
            (
                "ee_vs_prediction_mean_m",
                number(&|score| Some(score.ee_vs_prediction.mean_m)),
            ),
            (
                "ee_vs_prediction_rms_m",
                number(&|score| Some(score.ee_vs_prediction.rms_m)),
            ),
            (
                "ee_vs_prediction_max_m",
                number(&|score| Some(score.ee_vs_prediction.max_m)),
            ),
            ("target_miss_m", number(&|score| score.target_miss_m)),
        ]
        .map(|(name, values)| (name.to_owned(), values)),
    );
    columns
        .into_iter()
        .map(|(name, values)| Column { name, values })
        .collect()
}

impl Column {
    fn field(&self) -> ParquetResult<TypePtr> {
        let (physical, repetition, logical) = match self.values {
            Values::Text(_) => (
                Physical::BYTE_ARRAY,
                Repetition::REQUIRED,
                Some(LogicalType::String),
            ),
            Values::Integer(_) => (Physical::INT64, Repetition::REQUIRED, None),
            Values::Boolean(_) => (Physical::BOOLEAN, Repetition::REQUIRED, None),
            Values::Number(_) => (Physical::DOUBLE, Repetition::REQUIRED, None),
            Values::OptionalNumber(_) => (Physical::DOUBLE, Repetition::OPTIONAL, None),
            Values::OptionalCount(_) => (Physical::INT32, Repetition::OPTIONAL, None),
        };
        let field = Type::primitive_type_builder(&self.name, physical)
            .with_repetition(repetition)
            .with_logical_type(logical)
            .build()?;
        Ok(Arc::new(field))
    }

    fn write(&self, group: &mut SerializedRowGroupWriter<Vec<u8>>) -> ParquetResult<()> {
        match &self.values {
            Values::Text(values) => write_column::<ByteArrayType>(group, values, None),
            Values::Integer(values) => write_column::<Int64Type>(group, values, None),
            Values::Boolean(values) => write_column::<BoolType>(group, values, None),
            Values::Number(values) => write_column::<DoubleType>(group, values, None),
            Values::OptionalNumber(values) => write_optional::<DoubleType>(group, values),
            Values::OptionalCount(values) => write_optional::<Int32Type>(group, values),
        }
    }
}

fn write_optional<T: DataType>(
    group: &mut SerializedRowGroupWriter<Vec<u8>>,
    values: &[Option<T::T>],
) -> ParquetResult<()> {
    let present: Vec<T::T> = values.iter().flatten().cloned().collect();
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    write_column::<T>(group, &present, Some(&levels))
}

fn write_column<T: DataType>(
    group: &mut SerializedRowGroupWriter<Vec<u8>>,
    values: &[T::T],
    levels: Option<&[i16]>,
) -> ParquetResult<()> {
    // The schema has as many columns as are written.
    if let Some(mut column) = group.next_column()? {
        column.typed::<T>().write_batch(values, levels, None)?;
        column.close()?;
    }
    Ok(())
}
