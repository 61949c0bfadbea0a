//! Questions in SQL to a lake, answered by DataFusion in this process.
//!
//! The table `checks` is made of the files that count, as `flankscope-fleet files` lists them, and of nothing else. It is only read:
//! statements that write or define anything are refused, and no other file can be named. An answer is whole or there is none.

mod answer;
#[cfg(feature = "cluster")]
mod cluster;
mod file_reader;
pub(crate) mod sums;
mod table;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use datafusion::arrow::array::RecordBatch;
use datafusion::arrow::datatypes::SchemaRef;
use datafusion::arrow::error::ArrowError;
use datafusion::catalog::TableProvider;
use datafusion::error::DataFusionError;
use datafusion::execution::context::SQLOptions;
use datafusion::functions_aggregate::first_last::last_value_udaf;
use datafusion::parquet::errors::ParquetError;
use datafusion::prelude::{DataFrame, SessionConfig, SessionContext};

use crate::lake::{Address, Lake, LakeError, Listed};
use crate::name::FileName;
use crate::rows::Stream;
use crate::sums::SumsName;
use sums::{SUMS, SumsTable};
use table::ChecksTable;

pub use crate::sums::QUESTIONS_SQL;
pub use answer::Form;
#[cfg(feature = "cluster")]
pub use cluster::{Cluster, ClusterError};
pub use datafusion::common::ScalarValue;

/// The view that the names of files tell where to look for.
const LAST_CHECKS: &str = "last_checks";

/// Begins a question's name in [`QUESTIONS_SQL`].
const NAME: &str = "-- name: ";

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    #[error(transparent)]
    Lake(#[from] LakeError),
    #[error(
        "{one} and {other} have the same checks, so none of them is believed; `verify` says more"
    )]
    Doubled {
        one: Box<FileName>,
        other: Box<FileName>,
    },
    #[error("\"{asked}\" is neither SQL nor a named question; these are {}", names().join(", "))]
    NoQuestion { asked: String },
    #[error("{0}")]
    Engine(#[from] DataFusionError),
    #[error("the answer cannot be written: {0}")]
    Arrow(#[from] ArrowError),
    #[error("the answer cannot be written: {0}")]
    Parquet(#[from] ParquetError),
    #[error("the answer has other columns than were asked for: {0}")]
    Columns(#[from] serde_json::Error),
    #[error("the answer cannot be written: {0}")]
    Output(#[from] std::io::Error),
    #[cfg(feature = "cluster")]
    #[error(transparent)]
    Cluster(#[from] ClusterError),
}

/// A question with a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Question {
    pub name: &'static str,
    /// What it answers, in one sentence.
    pub sentence: &'static str,
    pub sql: &'static str,
}

/// The questions with a name, in the order of the file.
pub fn questions() -> impl Iterator<Item = Question> {
    let parts = QUESTIONS_SQL.split(NAME).skip(1);
    parts.filter_map(|part| {
        let (name, rest) = part.split_once("\n-- ")?;
        let (sentence, sql) = rest.split_once('\n')?;
        let sql = sql.trim().trim_end_matches(';');
        Some(Question {
            name,
            sentence,
            sql,
        })
    })
}

/// The views that the questions share, each by its name, in the order of the file.
fn views() -> impl Iterator<Item = (&'static str, &'static str)> {
    let views = QUESTIONS_SQL.split(NAME).next().unwrap_or_default();
    views.split_inclusive(";\n").filter_map(|view| {
        let (_, rest) = view.split_once("CREATE VIEW ")?;
        let (name, _) = rest.split_once(" AS")?;
        Some((name, view))
    })
}

fn names() -> Vec<&'static str> {
    questions().map(|question| question.name).collect()
}

/// What is asked: SQL, or the SQL of a name. No name is SQL, and no SQL is one word.
fn sql(asked: &str) -> Result<&str, QueryError> {
    let named = questions().find(|question| question.name == asked);
    match named {
        Some(question) => Ok(question.sql),
        None if asked.trim().contains(char::is_whitespace) => Ok(asked),
        None => Err(QueryError::NoQuestion {
            asked: asked.to_owned(),
        }),
    }
}

/// What is asked as a plan that only reads.
async fn planned(context: &SessionContext, asked: &str) -> Result<DataFrame, QueryError> {
    let only_read = SQLOptions::new()
        .with_allow_ddl(false)
        .with_allow_dml(false)
        .with_allow_statements(false);
    Ok(context.sql_with_options(sql(asked)?, only_read).await?)
}

/// Rows that answer a question.
#[derive(Debug)]
pub struct Answer {
    pub schema: SchemaRef,
    pub batches: Vec<RecordBatch>,
}

impl Answer {
    /// Its rows as values of a type with a field for every column that is wanted.
    ///
    /// # Errors
    /// A column is missing, or of another type.
    pub fn rows<T: serde::de::DeserializeOwned>(&self) -> Result<Vec<T>, QueryError> {
        let mut text = Vec::new();
        self.write(Form::Json, &mut text)?;
        Ok(serde_json::from_slice(&text)?)
    }
}

/// Asks a lake: SQL, or a named question.
///
/// # Errors
/// The lake cannot be read, a file that the answer needs is damaged, or the question is refused.
pub async fn ask(lake: &Lake, asked: &str) -> Result<Answer, QueryError> {
    Snapshot::of(lake).await?.ask(asked, Vec::new()).await
}

/// A lake with the files that count now. What is added later is not asked.
#[derive(Clone, Debug)]
pub struct Snapshot {
    lake: Lake,
    files: Vec<Listed>,
    sums: Vec<SumsName>,
    /// Where a cluster reads the files; `None`: this process answers.
    address: Option<Address>,
}

impl Snapshot {
    /// # Errors
    /// The lake cannot be listed, or two files have the same checks.
    pub async fn of(lake: &Lake) -> Result<Self, QueryError> {
        let listing = lake.list(None).await?;
        let found = listing.cover();
        if let Some((one, other)) = found.doubled.first() {
            return Err(QueryError::Doubled {
                one: Box::new(one.clone()),
                other: Box::new(other.clone()),
            });
        }
        let current: BTreeSet<&FileName> = found.current.iter().collect();
        let mut files = listing.files;
        files.retain(|file| current.contains(&file.name));
        Ok(Self {
            lake: lake.clone(),
            files,
            sums: listing.sums,
            address: None,
        })
    }

    /// Some of its files, without sums.
    fn only(&self, files: Vec<Listed>) -> Self {
        Self {
            lake: self.lake.clone(),
            files,
            sums: Vec::new(),
            address: self.address.clone(),
        }
    }

    /// The files, by name.
    pub fn names(&self) -> impl Iterator<Item = &FileName> {
        self.files.iter().map(|file| &file.name)
    }

    /// Asks it; `values` stand for `$1`, `$2`, … in SQL.
    ///
    /// # Errors
    /// A file that the answer needs is damaged, or the question is refused.
    pub async fn ask(&self, asked: &str, values: Vec<ScalarValue>) -> Result<Answer, QueryError> {
        let config = SessionConfig::new().with_information_schema(true);
        let mut frame = planned(&self.context(config).await?, asked).await?;
        if !values.is_empty() {
            frame = frame.with_param_values(values)?;
        }
        let schema = Arc::clone(frame.schema().inner());
        Ok(Answer {
            schema,
            batches: frame.collect().await?,
        })
    }

    /// The table and the views.
    async fn context(&self, config: SessionConfig) -> Result<SessionContext, QueryError> {
        let context = self.table(config)?;
        for (name, view) in views() {
            match name {
                // A cluster adds up rows: sums are read and checked in this process.
                SUMS if self.address.is_none() => {
                    context.register_table(name, Arc::new(SumsTable::new(self).await?))?
                }
                LAST_CHECKS => {
                    let last = self.only(self.last_files());
                    context.register_table(name, last.view(name).await?)?
                }
                _ => {
                    context.sql(view).await?;
                    None
                }
            };
        }
        Ok(context)
    }

    /// A view of these files' rows.
    async fn view(&self, wanted: &str) -> Result<Arc<dyn TableProvider>, QueryError> {
        let context = self.table(SessionConfig::new())?;
        for (name, view) in views() {
            context.sql(view).await?;
            if name == wanted {
                break;
            }
        }
        Ok(context.table_provider(wanted).await?)
    }

    /// The table alone.
    fn table(&self, config: SessionConfig) -> Result<SessionContext, QueryError> {
        let context = SessionContext::new_with_config(config);
        // DuckDB's word for it.
        let last = (*last_value_udaf()).clone().with_aliases(["last"]);
        context.register_udaf(last);
        let checks = ChecksTable::new(&self.lake, &self.files, self.address.as_ref())?;
        context.register_table("checks", Arc::new(checks))?;
        Ok(context)
    }

    /// The files with the last checks of each history at each station.
    fn last_files(&self) -> Vec<Listed> {
        let mut last: BTreeMap<(&str, &Stream), &Listed> = BTreeMap::new();
        for file in &self.files {
            let range = &file.name.range;
            let last = last.entry((&range.station, &range.stream)).or_insert(file);
            if last.name.range.last < range.last {
                *last = file;
            }
        }
        last.into_values().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use datafusion::arrow::util::display::array_value_to_string;
    use flankscope_record::seal::Seals;

    use super::*;
    use crate::file::LakeFile;
    use crate::file::tests::file;

    /// A new file, and one as a release without some columns would have written it, changed.
    fn asked(
        without: &[&str],
        changed: impl Fn(Vec<u8>) -> Vec<u8>,
    ) -> (FileName, Result<Vec<String>, QueryError>) {
        let folder = tempfile::tempdir().unwrap();
        let lake = Lake::open(folder.path().to_str().unwrap()).unwrap();
        let new = file();
        let (mut range, mut checks) = (new.range.clone(), new.checks.clone());
        (range.first, range.last) = (8, 8);
        checks[0].set("check_number", 8.into());
        let old = LakeFile::sealed(range, checks, &Seals::passing().unwrap());
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        let runtime = runtime.unwrap();
        for (file, bytes) in [
            (&new, new.encode().unwrap()),
            (&old, changed(old.encode_without(without).unwrap())),
        ] {
            let name = file.name().to_string();
            runtime.block_on(lake.put(&name, bytes)).unwrap();
        }
        let sql = "SELECT DISTINCT check_number || ' ' || coalesce(baseline, '-') || ' ' || coalesce(patch, '-') FROM checks ORDER BY 1";
        let answer = runtime.block_on(ask(&lake, sql)).map(|answer| {
            let rows = |batch: &RecordBatch| -> Vec<String> {
                let row = |row| array_value_to_string(batch.column(0), row).unwrap();
                (0..batch.num_rows()).map(row).collect()
            };
            answer.batches.iter().flat_map(rows).collect()
        });
        (old.name(), answer)
    }

    #[test]
    fn an_old_file_counts_beside_a_new_one_and_a_newer_one_is_refused_by_name() {
        let (_, answer) = asked(&["baseline", "patch"], |bytes| bytes);
        assert_eq!(answer.unwrap(), ["7 baseline patch", "8 - -"]);
        let replace = |from: &'static str, to: &'static str| {
            move |mut bytes: Vec<u8>| {
                let at = |at: &usize| bytes[*at..].starts_with(from.as_bytes());
                let places: Vec<usize> = (0..bytes.len()).filter(at).collect();
                assert!(!places.is_empty());
                for at in places {
                    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
                }
                bytes
            }
        };
        let newer = replace("flankscope.lake\x18\x011", "flankscope.lake\x18\x012");
        for ((name, answer), why) in [
            (asked(&[], newer), "version 2 of the table"),
            (asked(&[], replace("operator", "operated")), "\"operated\""),
            (asked(&["reason"], |bytes| bytes), "\"reason\" is missing"),
        ] {
            let error = answer.unwrap_err().to_string();
            assert!(
                error.contains(why) && error.contains(&name.to_string()),
                "{error}"
            );
        }
    }
}
