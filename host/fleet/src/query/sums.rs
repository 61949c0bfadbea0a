//! The view `sums`, taken from files for the days that have them and from rows for the others, and what those files hold.

use std::collections::BTreeSet;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use datafusion::arrow::array::RecordBatch;
use datafusion::arrow::compute::concat_batches;
use datafusion::arrow::datatypes::SchemaRef;
use datafusion::catalog::{Session, TableProvider};
use datafusion::common::{DataFusionError, Result as EngineResult};
use datafusion::datasource::TableType;
use datafusion::datasource::memory::MemorySourceConfig;
use datafusion::logical_expr::Expr;
use datafusion::parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use datafusion::parquet::arrow::{ArrowWriter, ProjectionMask};
use datafusion::parquet::basic::Compression;
use datafusion::parquet::file::properties::{EnabledStatistics, WriterProperties};
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::union::UnionExec;
use datafusion::prelude::SessionConfig;
use futures_util::{StreamExt, TryStreamExt};

use super::{QueryError, Snapshot};
use crate::lake::{Lake, LakeError, Listed};
use crate::sums::{SumsName, days};

/// The view's name.
pub(super) const SUMS: &str = "sums";

/// Files of sums that are read at a time.
const AT_A_TIME: usize = 16;

/// The sums of a day by its rows, as its file holds them: the same bytes for the same files and release, because one thread adds them
/// up in one order.
///
/// # Errors
/// A file cannot be read.
pub(crate) async fn of_rows(lake: &Lake, files: Vec<Listed>) -> Result<Vec<u8>, QueryError> {
    let day = Snapshot {
        lake: lake.clone(),
        files,
        sums: Vec::new(),
        address: None,
    };
    let context = day.context(SessionConfig::new().with_target_partitions(1));
    let in_order = "SELECT * FROM sums ORDER BY date, simulated, tool, serial, place, run, station, baseline, head_blake3, tooth, flank, patch";
    let frame = context.await?.sql(in_order).await?;
    let properties = WriterProperties::builder()
        .set_created_by("flankscope-fleet".into())
        .set_compression(Compression::LZ4_RAW)
        .set_statistics_enabled(EnabledStatistics::None)
        .build();
    let schema = Arc::clone(frame.schema().inner());
    let mut writer = ArrowWriter::try_new(Vec::new(), schema, Some(properties))?;
    for batch in frame.collect().await? {
        writer.write(&batch)?;
    }
    Ok(writer.into_inner()?)
}

/// Whether a day's sums are those of its rows.
///
/// # Errors
/// A file cannot be read.
pub(crate) async fn are_of_rows(
    lake: &Lake,
    files: Vec<Listed>,
    bytes: Bytes,
) -> Result<bool, QueryError> {
    let by_rows = Bytes::from(of_rows(lake, files).await?);
    // Another release may have compressed them otherwise.
    Ok(bytes == by_rows || rows_in(bytes).ok() == rows_in(by_rows).ok())
}

fn rows_in(bytes: Bytes) -> EngineResult<RecordBatch> {
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes)?;
    let schema = Arc::clone(reader.schema());
    let batches: Vec<RecordBatch> = reader.build()?.collect::<Result<_, _>>()?;
    Ok(concat_batches(&schema, &batches)?)
}

/// The files that are whole.
async fn read_all(lake: &Lake, names: Vec<SumsName>) -> Result<Vec<(SumsName, Bytes)>, LakeError> {
    let read = |name: SumsName| async {
        let bytes = lake.read_sums(&name).await;
        bytes.map(|bytes| bytes.map(|bytes| (name, bytes)))
    };
    let read = futures_util::stream::iter(names).map(read);
    let whole: Vec<Option<_>> = read.buffered(AT_A_TIME).try_collect().await?;
    Ok(whole.into_iter().flatten().collect())
}

/// The table that stands for the view.
#[derive(Debug)]
pub(super) struct SumsTable {
    snapshot: Snapshot,
    schema: SchemaRef,
}

impl SumsTable {
    pub async fn new(snapshot: &Snapshot) -> Result<Self, QueryError> {
        // The columns are the same whatever the files are.
        let by_rows = snapshot.only(Vec::new()).view(SUMS).await?;
        Ok(Self {
            snapshot: snapshot.clone(),
            schema: by_rows.schema(),
        })
    }

    /// The rows of a file; `None` if it is not as this release writes it.
    fn decode(
        &self,
        name: &SumsName,
        bytes: Bytes,
        projection: Option<&Vec<usize>>,
    ) -> Option<Vec<RecordBatch>> {
        let decode = || -> EngineResult<Vec<RecordBatch>> {
            let reader = ParquetRecordBatchReaderBuilder::try_new(bytes)?;
            if *reader.schema() != self.schema {
                let why = "it has other columns than the view `sums`";
                return Err(DataFusionError::Execution(why.into()));
            }
            let columns = match projection {
                Some(columns) => {
                    ProjectionMask::roots(reader.parquet_schema(), columns.iter().copied())
                }
                None => ProjectionMask::all(),
            };
            let reader = reader.with_projection(columns).build()?;
            Ok(reader.collect::<Result<_, _>>()?)
        };
        let decoded = decode();
        if let Err(error) = &decoded {
            tracing::warn!(%error, "{name} is not believed");
        }
        decoded.ok()
    }
}

#[async_trait]
impl TableProvider for SumsTable {
    fn schema(&self) -> SchemaRef {
        Arc::clone(&self.schema)
    }

    fn table_type(&self) -> TableType {
        TableType::View
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        _filters: &[Expr],
        _limit: Option<usize>,
    ) -> EngineResult<Arc<dyn ExecutionPlan>> {
        let Snapshot {
            lake, files, sums, ..
        } = &self.snapshot;
        let days = days(files.iter().map(|file| &file.name));
        let source = |name: &SumsName| days.get(&name.date[..]).map(|day| &day.source);
        let valid = sums
            .iter()
            .filter(|name| source(name) == Some(&name.source));
        let valid: Vec<SumsName> = valid.cloned().collect();
        let read = read_all(lake, valid).await;
        let read = read.map_err(|error| DataFusionError::External(Box::new(error)))?;
        let mut kept = vec![Vec::new(); state.config().target_partitions()];
        let mut summed: BTreeSet<String> = BTreeSet::new();
        for (name, bytes) in read {
            if summed.contains(&name.date) {
                continue;
            }
            if let Some(batches) = self.decode(&name, bytes, projection) {
                let part = summed.len() % kept.len();
                kept[part].extend(batches);
                summed.insert(name.date);
            }
        }
        let schema = match projection {
            Some(columns) => Arc::new(self.schema.project(columns)?),
            None => self.schema(),
        };
        let kept: Arc<dyn ExecutionPlan> = MemorySourceConfig::try_new_exec(&kept, schema, None)?;
        let others = files.iter();
        let others = others.filter(|file| !summed.contains(&file.name.range.date));
        let others: Vec<Listed> = others.cloned().collect();
        if others.is_empty() {
            return Ok(kept);
        }
        let by_rows = self.snapshot.only(others).view(SUMS).await;
        let by_rows = by_rows.map_err(|error| DataFusionError::External(Box::new(error)))?;
        let by_rows = by_rows.scan(state, projection, &[], None).await?;
        UnionExec::try_new(vec![kept, by_rows])
    }
}
