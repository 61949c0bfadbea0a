//! Questions to a lake, answered by a cluster: the scheduler and executors of Apache Ballista as they are published.
//!
//! This process lists the lake, chooses the files that count, checks their metadata and plans the question. The plan names each file, so
//! executors read these and no others, at the lake's own address and with credentials of their own. Sums of days are not used.

use std::sync::Arc;
use std::time::Duration;

use ballista_core::execution_plans::execute_physical_plan;
use ballista_core::extension::SessionConfigExt;
use ballista_core::optimizer::ballista_default_optimizer_rules;
use ballista_core::planner::scans_only_information_schema;
use datafusion::arrow::array::RecordBatch;
use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::error::DataFusionError;
use datafusion::execution::SessionStateBuilder;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::logical_expr::LogicalPlan;
use datafusion::object_store::memory::InMemory;
use datafusion::physical_plan::windows::{BoundedWindowAggExec, WindowAggExec};
use datafusion::physical_plan::{ExecutionPlan, displayable};
use datafusion::prelude::{SessionConfig, SessionContext};
use datafusion_proto::physical_plan::AsExecutionPlan;
use datafusion_proto::protobuf::PhysicalPlanNode;
use futures_util::TryStreamExt;

use super::{Answer, QueryError, Snapshot, planned};
use crate::lake::Lake;

/// How long executors may take for a plan without work. A scheduler that has none would keep a question for ever.
const FIRST_ANSWER: Duration = Duration::from_secs(60);

/// Bytes of files that one task reads, and the least number of tasks of a stage.
const TASK_BYTES: u64 = 64 << 20;
const LEAST_TASKS: u64 = 16;

/// Largest message that is sent and taken: the scheduler's own limit (`--grpc-server-max-decoding-message-size`) decides.
const MESSAGE_BYTES: usize = u32::MAX as usize;

/// Why a cluster gives no answer.
#[derive(Debug, thiserror::Error)]
pub enum ClusterError {
    #[error("cluster {url}: not of the form df://HOST:PORT")]
    Url { url: String },
    #[error("other machines cannot find this lake: it is neither a folder nor s3://BUCKET/PREFIX")]
    Address,
    #[error("EXPLAIN ANALYZE is for a question without --cluster")]
    Analyze,
    #[error(
        "a cluster would answer something else: parts of this plan get lost on the way to it, such as FILTER and IGNORE NULLS of a window \
         function; write CASE, or ask without --cluster"
    )]
    Lost,
    #[error(
        "cluster {url}: no executor answered within {} s: none is connected to the scheduler, or all are busy", FIRST_ANSWER.as_secs()
    )]
    NoExecutor { url: String },
    #[error("cluster {url}: {why}")]
    Failed {
        url: String,
        /// As the cluster tells it.
        why: DataFusionError,
    },
}

/// A cluster, by its scheduler.
#[derive(Clone, Debug)]
pub struct Cluster {
    url: String,
    scheduler: String,
}

impl Cluster {
    /// # Errors
    /// It is not of the form `df://HOST:PORT`.
    pub fn new(url: &str) -> Result<Self, ClusterError> {
        let place = url.strip_prefix("df://").and_then(|place| {
            let (host, port) = place.rsplit_once(':')?;
            let odd = |c: char| c.is_whitespace() || "/@?#".contains(c);
            let good = !host.is_empty() && !host.contains(odd) && port.parse() != Ok(0_u16);
            (good && port.parse::<u16>().is_ok()).then_some(place)
        });
        let place = place.ok_or_else(|| ClusterError::Url { url: url.into() })?;
        Ok(Self {
            url: url.into(),
            scheduler: format!("http://{place}"),
        })
    }

    /// Asks a lake: SQL, or a named question.
    ///
    /// # Errors
    /// As of [`ask`](super::ask); or the cluster cannot be reached, has no executor, or gave up.
    pub async fn ask(&self, lake: &Lake, asked: &str) -> Result<Answer, QueryError> {
        let mut snapshot = Snapshot::of(lake).await?;
        let address = lake.address().ok_or(ClusterError::Address)?;
        snapshot.address = Some(address.clone());
        let bytes: u64 = snapshot.files.iter().map(|file| file.bytes).sum();
        let tasks = (bytes / TASK_BYTES).max(LEAST_TASKS);
        let config = SessionConfig::new_with_ballista()
            .with_target_partitions(usize::try_from(tasks).unwrap_or(usize::MAX))
            .with_ballista_grpc_client_max_message_size(MESSAGE_BYTES);
        let context = snapshot.context(config).await?;
        let state = SessionStateBuilder::new_from_existing(context.state())
            .with_optimizer_rules(ballista_default_optimizer_rules());
        let context = SessionContext::new_with_state(state.build());
        // A plan is only decoded where its store is known; nothing is read from it here.
        let store = ObjectStoreUrl::parse(&address.store)?;
        context.register_object_store(store.as_ref(), Arc::new(InMemory::new()));
        let frame = planned(&context, asked).await?;
        let schema = frame.schema().inner().clone();
        let batches = match frame.logical_plan() {
            LogicalPlan::Analyze(_) => return Err(ClusterError::Analyze.into()),
            // Of tables and plans this process knows all.
            LogicalPlan::Explain(_) | LogicalPlan::DescribeTable(_) => frame.collect().await?,
            plan if scans_only_information_schema(plan)? => frame.collect().await?,
            _ => {
                let plan = frame.create_physical_plan().await?;
                carried(&plan, &context)?;
                let nothing = planned(&context, "SELECT 1").await?;
                let first = self.run(&context, nothing.create_physical_plan().await?);
                let no_executor = |_| ClusterError::NoExecutor {
                    url: self.url.clone(),
                };
                tokio::time::timeout(FIRST_ANSWER, first)
                    .await
                    .map_err(no_executor)??;
                self.run(&context, plan).await?
            }
        };
        Ok(Answer { schema, batches })
    }

    async fn run(
        &self,
        context: &SessionContext,
        plan: Arc<dyn ExecutionPlan>,
    ) -> Result<Vec<RecordBatch>, ClusterError> {
        let config = context.copied_config();
        let (ballista, codec) = (
            config.ballista_config(),
            config.ballista_physical_extension_codec(),
        );
        let rows = async {
            execute_physical_plan::<PhysicalPlanNode>(
                self.scheduler.clone(),
                &ballista,
                plan,
                codec.as_ref(),
                context.session_id(),
                config,
            )
            .await?
            .try_collect()
            .await
        };
        rows.await.map_err(|why| ClusterError::Failed {
            url: self.url.clone(),
            why,
        })
    }
}

/// Whether a plan is what it was when it has been sent: its encoding (55.2) has no place for some parts, and drops them without a word.
fn carried(plan: &Arc<dyn ExecutionPlan>, context: &SessionContext) -> Result<(), QueryError> {
    let config = context.copied_config();
    let codec = config.ballista_physical_extension_codec();
    let sent = PhysicalPlanNode::try_from_physical_plan(Arc::clone(plan), codec.as_ref())?;
    let taken = sent.try_into_physical_plan(&context.task_ctx(), codec.as_ref())?;
    match contents(plan)? == contents(&taken)? {
        true => Ok(()),
        false => Err(ClusterError::Lost.into()),
    }
}

/// A plan as text, with what its usual text leaves out of window functions.
fn contents(plan: &Arc<dyn ExecutionPlan>) -> Result<String, DataFusionError> {
    let mut text = displayable(plan.as_ref()).indent(true).to_string();
    plan.apply(|node| {
        let windows = node.downcast_ref::<WindowAggExec>();
        let windows = windows.map(WindowAggExec::window_expr);
        let bounded = node.downcast_ref::<BoundedWindowAggExec>();
        let bounded = bounded.map(BoundedWindowAggExec::window_expr);
        for window in windows.into_iter().chain(bounded).flatten() {
            // An aggregate holds the schema of its whole input, which is not sent.
            let all = format!("{window:?}\n");
            let schema = all.find("schema: Schema {").zip(all.find("order_bys:"));
            let (before, behind) = schema.unwrap_or((all.len(), all.len()));
            text.extend([&all[..before], all.get(behind..).unwrap_or_default()]);
        }
        Ok(TreeNodeRecursion::Continue)
    })?;
    Ok(text)
}
