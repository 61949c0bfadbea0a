//! Writes all values of a history as an Apache Parquet file, for tools that read columns; the columns are those of the CSV.

use ::parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type,
};
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use ::parquet::schema::parser::parse_message_type;
use std::sync::Arc;

use super::rows::{Check, FlankRow};

const SCHEMA: &str = "message history {
    REQUIRED INT64 check;
    REQUIRED BINARY at (STRING);
    REQUIRED BINARY tool (STRING);
    REQUIRED INT64 tool_cycles;
    REQUIRED INT64 press_cycles;
    OPTIONAL BINARY baseline (STRING);
    REQUIRED BINARY check_verdict (STRING);
    REQUIRED INT32 tooth;
    REQUIRED BINARY flank (STRING);
    OPTIONAL DOUBLE wear_um;
    OPTIONAL DOUBLE u95_um;
    REQUIRED DOUBLE warn_um;
    REQUIRED DOUBLE limit_um;
    REQUIRED BINARY verdict (STRING);
    OPTIONAL BINARY code (STRING);
    REQUIRED BINARY link (STRING);
    REQUIRED BOOLEAN simulated;
    REQUIRED BINARY head (STRING);
    REQUIRED BINARY head_blake3 (STRING);
    REQUIRED BINARY station (STRING);
    OPTIONAL BINARY operator (STRING);
    OPTIONAL BINARY patch (STRING);
}";

type Row<'a> = (&'a Check, &'a FlankRow);

/// The bytes of a Parquet file with a row per check and flank.
///
/// # Errors
/// Errors of the writer; none occur when writing to memory.
pub fn parquet(checks: &[Check]) -> Result<Vec<u8>, ParquetError> {
    let rows: Vec<Row<'_>> = checks
        .iter()
        .flat_map(|check| check.flanks.iter().map(move |flank| (check, flank)))
        .collect();
    let schema = Arc::new(parse_message_type(SCHEMA)?);
    let properties = Arc::new(WriterProperties::builder().build());
    let mut file = SerializedFileWriter::new(Vec::new(), schema, properties)?;
    write(file.next_row_group()?, &rows)?;
    file.into_inner()
}

/// Writes all columns, in the order of the schema.
fn write(
    group: SerializedRowGroupWriter<'_, Vec<u8>>,
    rows: &[Row<'_>],
) -> Result<(), ParquetError> {
    let mut columns = Columns { group, rows };
    columns.all::<Int64Type>(|(check, _)| check.id)?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.at))?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.tool))?;
    columns.all::<Int64Type>(|(check, _)| check.tool_cycles)?;
    columns.all::<Int64Type>(|(check, _)| check.press_cycles)?;
    columns.some::<ByteArrayType>(|(check, _)| check.baseline.as_deref().map(text))?;
    columns.all::<ByteArrayType>(|(check, _)| text(check.verdict.as_str()))?;
    columns.all::<Int32Type>(|(_, flank)| i32::try_from(flank.id.tooth).unwrap_or(i32::MAX))?;
    columns.all::<ByteArrayType>(|(_, flank)| text(flank.id.flank.word()))?;
    columns.some::<DoubleType>(|(_, flank)| flank.wear_um)?;
    columns.some::<DoubleType>(|(_, flank)| flank.u95_um)?;
    columns.all::<DoubleType>(|(_, flank)| flank.warn_um)?;
    columns.all::<DoubleType>(|(_, flank)| flank.limit_um)?;
    columns.all::<ByteArrayType>(|(_, flank)| text(flank.verdict.as_str()))?;
    columns.some::<ByteArrayType>(|(_, flank)| flank.code.map(|code| text(code.word())))?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.origin.link))?;
    columns.all::<BoolType>(|(check, _)| check.origin.simulated)?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.origin.head.name))?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.origin.head.blake3))?;
    columns.all::<ByteArrayType>(|(check, _)| text(&check.origin.station))?;
    columns.some::<ByteArrayType>(|(check, _)| check.origin.operator.as_deref().map(text))?;
    columns.some::<ByteArrayType>(|(_, flank)| flank.id.patch.as_deref().map(text))?;
    columns.group.close()?;
    Ok(())
}

fn text(text: &str) -> ByteArray {
    ByteArray::from(text)
}

/// The columns of one group of rows, in the order of the schema.
struct Columns<'a, 'b> {
    group: SerializedRowGroupWriter<'b, Vec<u8>>,
    rows: &'a [Row<'a>],
}

impl Columns<'_, '_> {
    /// A column with a value in every row.
    fn all<T: DataType>(&mut self, of: impl Fn(&Row<'_>) -> T::T) -> Result<(), ParquetError> {
        let values: Vec<T::T> = self.rows.iter().map(of).collect();
        self.write::<T>(&values, None)
    }

    /// A column that may be empty in a row.
    fn some<T: DataType>(
        &mut self,
        of: impl Fn(&Row<'_>) -> Option<T::T>,
    ) -> Result<(), ParquetError> {
        let values: Vec<Option<T::T>> = self.rows.iter().map(of).collect();
        let present: Vec<i16> = values.iter().map(|v| i16::from(v.is_some())).collect();
        let values: Vec<T::T> = values.into_iter().flatten().collect();
        self.write::<T>(&values, Some(&present))
    }

    fn write<T: DataType>(
        &mut self,
        values: &[T::T],
        present: Option<&[i16]>,
    ) -> Result<(), ParquetError> {
        if let Some(mut column) = self.group.next_column()? {
            column.typed::<T>().write_batch(values, present, None)?;
            column.close()?;
        }
        Ok(())
    }
}
