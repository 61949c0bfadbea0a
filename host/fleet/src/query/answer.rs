//! Answers as a table for people, CSV, JSON and Parquet.

use std::io::Write;
use std::sync::Arc;

use datafusion::arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use datafusion::arrow::datatypes::{DataType, Field, Float64Type, Schema};
use datafusion::arrow::util::pretty::pretty_format_batches_with_schema;
use datafusion::arrow::{csv, error::ArrowError, json};
use datafusion::parquet::arrow::ArrowWriter;

use super::{Answer, QueryError};

/// How an answer is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Form {
    /// For people: figures with six digits.
    Table,
    /// With a line of names; figures with all digits.
    Csv,
    /// A list of objects; what is empty is null.
    Json,
    Parquet,
}

impl Answer {
    /// Writes it.
    ///
    /// # Errors
    /// The output cannot be written, or has no form for a value.
    pub fn write(&self, form: Form, mut output: impl Write + Send) -> Result<(), QueryError> {
        match form {
            Form::Table => {
                let batches: Result<Vec<_>, _> = self.batches.iter().map(readable).collect();
                let schema = readable(&RecordBatch::new_empty(Arc::clone(&self.schema)))?.schema();
                writeln!(
                    output,
                    "{}",
                    pretty_format_batches_with_schema(schema, &batches?)?
                )?;
            }
            Form::Csv => {
                let mut writer = csv::Writer::new(&mut output);
                writer.write(&RecordBatch::new_empty(Arc::clone(&self.schema)))?;
                for batch in &self.batches {
                    writer.write(batch)?;
                }
            }
            Form::Json => {
                let builder = json::WriterBuilder::new().with_explicit_nulls(true);
                let mut writer = builder.build::<_, json::writer::JsonArray>(&mut output);
                for batch in &self.batches {
                    writer.write(batch)?;
                }
                writer.finish()?;
                drop(writer);
                writeln!(output)?;
            }
            Form::Parquet => {
                let mut writer = ArrowWriter::try_new(&mut output, Arc::clone(&self.schema), None)?;
                for batch in &self.batches {
                    writer.write(batch)?;
                }
                writer.close()?;
            }
        }
        Ok(output.flush()?)
    }
}

/// Figures as text with six digits.
fn readable(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    let (mut fields, mut columns) = (Vec::new(), Vec::new());
    for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
        if *field.data_type() == DataType::Float64 {
            fields.push(Field::new(field.name(), DataType::Utf8, true));
            let figures = column.as_primitive::<Float64Type>().iter();
            let texts: StringArray = figures.map(|figure| figure.map(six_digits)).collect();
            columns.push(Arc::new(texts) as ArrayRef);
        } else {
            fields.push(field.as_ref().clone());
            columns.push(Arc::clone(column));
        }
    }
    RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)
}

fn six_digits(figure: f64) -> String {
    let magnitude = figure.abs().log10().floor();
    if figure == 0.0 || !figure.is_finite() {
        figure.to_string()
    } else if (-4.0..15.0).contains(&magnitude) {
        let decimals = (5.0 - magnitude).max(0.0) as usize;
        format!("{figure:.decimals$}")
    } else {
        format!("{figure:.5e}")
    }
}

#[cfg(test)]
mod tests {
    use super::six_digits;

    #[test]
    fn figures_have_six_digits_and_whole_ones_all() {
        for (figure, text) in [
            (0.0, "0"),
            (0.012_345_678, "0.0123457"),
            (-12.345_678, "-12.3457"),
            (12_345_678.4, "12345678"),
            (1.234_567_8e-9, "1.23457e-9"),
            (f64::NAN, "NaN"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(six_digits(figure), text);
        }
    }
}
