//! Reads files of the lake for DataFusion, through the store that the lake itself uses.
//!
//! What cannot be read, or is of a newer release, is named with its file: an answer never lacks rows without a word.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use datafusion::common::Result as EngineResult;
use datafusion::datasource::listing::PartitionedFile;
use datafusion::datasource::physical_plan::ParquetFileReaderFactory;
use datafusion::parquet::arrow::arrow_reader::ArrowReaderOptions;
use datafusion::parquet::arrow::async_reader::AsyncFileReader;
use datafusion::parquet::errors::ParquetError;
use datafusion::parquet::file::metadata::{ParquetMetaData, ParquetMetaDataReader};
use datafusion::physical_plan::metrics::ExecutionPlanMetricsSet;
use futures_util::future::BoxFuture;
use futures_util::{FutureExt, StreamExt, TryStreamExt};

use crate::file::{FileError, VERSION_KEY, check_columns, check_version};
use crate::lake::{Lake, LakeError};
use crate::name::FileName;

/// Bytes at the end of a file that are read at once: its metadata take less.
const METADATA_BYTES: usize = 1 << 15;

/// Files whose metadata are checked at a time.
const AT_A_TIME: usize = 32;

/// Opens files of a lake.
#[derive(Debug)]
pub(super) struct LakeFileReaders {
    pub lake: Lake,
}

impl LakeFileReaders {
    fn reader(&self, file: &PartitionedFile) -> LakeFileReader {
        LakeFileReader {
            lake: self.lake.clone(),
            bytes: file.object_meta.size,
            name: file.extension::<FileName>().cloned(),
        }
    }

    /// Checks the files' metadata as reading them does, for an engine that reads them with a reader of its own.
    ///
    /// # Errors
    /// One cannot be read, is cut short or of a newer release.
    pub async fn check(&self, files: &[PartitionedFile]) -> EngineResult<()> {
        let readers: Vec<LakeFileReader> = files.iter().map(|file| self.reader(file)).collect();
        let checks = readers.into_iter().map(|mut reader| async move {
            reader.get_metadata(None).await?;
            Ok(())
        });
        let checks = futures_util::stream::iter(checks);
        checks.buffer_unordered(AT_A_TIME).try_collect().await
    }
}

impl ParquetFileReaderFactory for LakeFileReaders {
    fn create_reader(
        &self,
        _partition: usize,
        file: PartitionedFile,
        _metadata_bytes: Option<usize>,
        _metrics: &ExecutionPlanMetricsSet,
    ) -> EngineResult<Box<dyn AsyncFileReader + Send>> {
        Ok(Box::new(self.reader(&file)))
    }
}

struct LakeFileReader {
    lake: Lake,
    name: Option<FileName>,
    bytes: u64,
}

impl LakeFileReader {
    fn name(&self) -> Result<&FileName, ParquetError> {
        let none = || ParquetError::General("a file without a name of the lake".into());
        self.name.as_ref().ok_or_else(none)
    }

    /// The error with the file's name.
    fn named(&self, why: impl std::fmt::Display) -> ParquetError {
        let name = self
            .name
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        ParquetError::External(format!("{name}: {why}").into())
    }
}

impl AsyncFileReader for LakeFileReader {
    fn get_bytes(&mut self, range: Range<u64>) -> BoxFuture<'_, Result<Bytes, ParquetError>> {
        async move {
            let all = self.get_byte_ranges(vec![range]).await?;
            Ok(all.into_iter().next().unwrap_or_default())
        }
        .boxed()
    }

    fn get_byte_ranges(
        &mut self,
        ranges: Vec<Range<u64>>,
    ) -> BoxFuture<'_, Result<Vec<Bytes>, ParquetError>> {
        async move {
            let read = self.lake.read_ranges(self.name()?, &ranges).await;
            let read = read.map_err(|error: LakeError| self.named(error))?;
            let whole = read
                .iter()
                .zip(&ranges)
                .all(|(bytes, range)| bytes.len() as u64 == range.end - range.start);
            match whole {
                true => Ok(read),
                false => Err(self.named("it became shorter while it was read")),
            }
        }
        .boxed()
    }

    fn get_metadata<'a>(
        &'a mut self,
        _options: Option<&'a ArrowReaderOptions>,
    ) -> BoxFuture<'a, Result<Arc<ParquetMetaData>, ParquetError>> {
        async move {
            let bytes = self.bytes;
            let reader = ParquetMetaDataReader::new().with_prefetch_hint(Some(METADATA_BYTES));
            let metadata = reader.load_and_finish(&mut *self, bytes).await;
            let metadata = metadata.map_err(|error| {
                self.named(format!("it is no whole Parquet file of this kind: {error}"))
            })?;
            known(&metadata).map_err(|error| self.named(error))?;
            Ok(Arc::new(metadata))
        }
        .boxed()
    }
}

/// Whether this release knows the file's version and columns, and all that every check has are there.
fn known(metadata: &ParquetMetaData) -> Result<(), FileError> {
    let file = metadata.file_metadata();
    let mut pairs = file.key_value_metadata().into_iter().flatten();
    let version = pairs.find(|pair| pair.key == VERSION_KEY);
    check_version(version.and_then(|pair| pair.value.as_deref()))?;
    let columns = file.schema_descr().columns().iter();
    check_columns(&columns.map(|column| column.name()).collect::<Vec<&str>>())
}
