//! The table `checks`: the files that count, with their station and day as columns.

use std::sync::Arc;

use async_trait::async_trait;
use datafusion::arrow::datatypes::{DataType, Field, FieldRef, Schema, SchemaRef, TimeUnit};
use datafusion::catalog::{Session, TableProvider};
use datafusion::common::{DFSchema, Result as EngineResult, ScalarValue, project_schema};
use datafusion::datasource::TableType;
use datafusion::datasource::listing::PartitionedFile;
use datafusion::datasource::listing::helpers::{expr_applicable_for_cols, filter_partitioned_file};
use datafusion::datasource::physical_plan::{FileGroup, FileScanConfigBuilder, ParquetSource};
use datafusion::datasource::source::DataSourceExec;
use datafusion::datasource::table_schema::TableSchema;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::logical_expr::{Expr, TableProviderFilterPushDown};
use datafusion::object_store::path::Path;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::empty::EmptyExec;

use super::file_reader::LakeFileReaders;
use crate::lake::{Address, Lake, Listed};
use crate::name::FileName;
use crate::rows::{COLUMNS, Column, Kind, Level};

/// Columns that are not in the files but in their folders' names.
const OF_FOLDERS: [&str; 2] = ["station", "date"];

/// The table.
#[derive(Debug)]
pub(super) struct ChecksTable {
    schema: TableSchema,
    files: Vec<PartitionedFile>,
    readers: Arc<LakeFileReaders>,
    /// Where the processes of a cluster read the files, by readers that check nothing; `None`: they are read here.
    address: Option<Address>,
}

impl ChecksTable {
    /// # Errors
    /// A folder's date is none.
    pub fn new(lake: &Lake, files: &[Listed], address: Option<&Address>) -> EngineResult<Self> {
        // Ballista advises against views in what it sends between processes.
        let plain = address.is_some();
        let [station, date] = OF_FOLDERS;
        let of_folders: Vec<FieldRef> = vec![
            Arc::new(Field::new(station, text(plain), false)),
            Arc::new(Field::new(date, DataType::Date32, false)),
        ];
        let columns: Vec<Field> = COLUMNS.iter().map(|column| field(column, plain)).collect();
        Ok(Self {
            schema: TableSchema::builder(Arc::new(Schema::new(columns)))
                .with_table_partition_cols(of_folders)
                .build(),
            files: files
                .iter()
                .map(|file| partitioned(file, plain))
                .collect::<EngineResult<_>>()?,
            readers: Arc::new(LakeFileReaders { lake: lake.clone() }),
            address: address.cloned(),
        })
    }
}

fn text(plain: bool) -> DataType {
    match plain {
        true => DataType::Utf8,
        false => DataType::Utf8View,
    }
}

fn field(column: &Column, plain: bool) -> Field {
    let kind = match (column.kind, column.level) {
        (Kind::Text, _) => text(plain),
        (Kind::Integer, Level::Flank) => DataType::Int32,
        (Kind::Integer, Level::Check) => DataType::Int64,
        (Kind::Real, _) => DataType::Float64,
        (Kind::Boolean, _) => DataType::Boolean,
        (Kind::Digest, _) if plain => DataType::Binary,
        (Kind::Digest, _) => DataType::BinaryView,
        (Kind::Time, _) => DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into())),
    };
    Field::new(column.name, kind, !column.required)
}

fn partitioned(file: &Listed, plain: bool) -> EngineResult<PartitionedFile> {
    let range = &file.name.range;
    let values = vec![
        ScalarValue::try_from_string(range.station.clone(), &text(plain))?,
        ScalarValue::try_from_string(range.date.clone(), &DataType::Date32)?,
    ];
    Ok(PartitionedFile::new(file.name.to_string(), file.bytes)
        .with_partition_values(values)
        .with_extension(file.name.clone()))
}

#[async_trait]
impl TableProvider for ChecksTable {
    fn schema(&self) -> SchemaRef {
        Arc::clone(self.schema.table_schema())
    }

    fn table_type(&self) -> TableType {
        TableType::Base
    }

    fn supports_filters_pushdown(
        &self,
        filters: &[&Expr],
    ) -> EngineResult<Vec<TableProviderFilterPushDown>> {
        // Files are left out by station and date; rows are filtered behind.
        Ok(vec![TableProviderFilterPushDown::Inexact; filters.len()])
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> EngineResult<Arc<dyn ExecutionPlan>> {
        let of_folders = filters
            .iter()
            .filter(|filter| expr_applicable_for_cols(&OF_FOLDERS, filter));
        let of_folders: Vec<Expr> = of_folders.cloned().collect();
        let folders = Schema::new(self.schema.table_partition_cols().clone());
        let folders = DFSchema::try_from(folders)?;
        let mut files = Vec::new();
        for file in &self.files {
            files.extend(filter_partitioned_file(
                file.clone(),
                &of_folders,
                &folders,
            )?);
        }
        if files.is_empty() {
            let schema = project_schema(self.schema.table_schema(), projection)?;
            return Ok(Arc::new(EmptyExec::new(schema)));
        }
        let mut source = ParquetSource::new(self.schema.clone());
        let store = match &self.address {
            None => {
                source = source.with_parquet_file_reader_factory(Arc::clone(&self.readers) as _);
                // Files are read through the lake; the address only says that they all are of one place.
                ObjectStoreUrl::local_filesystem()
            }
            Some(Address { store, prefix }) => {
                self.readers.check(&files).await?;
                for file in &mut files {
                    let name = file.extension::<FileName>().map(ToString::to_string);
                    let path = format!("{prefix}/{}", name.unwrap_or_default());
                    file.object_meta.location = Path::parse(path)?;
                }
                ObjectStoreUrl::parse(store)?
            }
        };
        let scan = FileScanConfigBuilder::new(store, Arc::new(source))
            .with_file_groups(FileGroup::new(files).split_files(state.config().target_partitions()))
            .with_projection_indices(projection.cloned())?
            .with_limit(limit)
            .build();
        Ok(DataSourceExec::from_data_source(scan))
    }
}
