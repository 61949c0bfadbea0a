//! The nodes as the server holds them: they are replaced by what stands, and the methods that acknowledge and start a check.

use std::collections::BTreeMap;

use async_trait::async_trait;
use opcua::nodes::{EventNotifier, MethodBuilder, NodeType, ObjectBuilder, VariableBuilder};
use opcua::server::SubscriptionCache;
use opcua::server::address_space::AddressSpace;
use opcua::server::diagnostics::NamespaceMetadata;
use opcua::server::node_manager::memory::{InMemoryNodeManager, InMemoryNodeManagerImpl};
use opcua::server::node_manager::{MethodCall, RequestContext, ServerContext};
use opcua::sync::RwLock;
use opcua::types::{
    Argument, AttributeId, DataTypeId, DataValue, LocalizedText, NodeId, ObjectId, QualifiedName,
    ReferenceTypeId, StatusCode, Variant,
};

use flankscope_record::check_request::RequestError;

use super::space::{DEVICES, Kind, MACHINERY, Method, Names, Node};
use super::types::{self, NAMESPACE, Types};
use super::users::Authenticator;
use crate::access::User;
use crate::acknowledge::{Acknowledging, Refused};
use crate::start_check::{NotStarted, start_check};

/// The server's holder of this program's nodes.
pub type Manager = InMemoryNodeManager<PlantNodes>;

/// What is shown now, by the text of its identifier.
pub type Shown = BTreeMap<String, Node>;

/// What the methods need beside the nodes.
pub struct PlantNodes {
    pub names: Names,
    namespaces: Vec<NamespaceMetadata>,
    users: Authenticator,
    acknowledging: Acknowledging,
    /// Methods, and the tools they are of, by the text of the method's identifier.
    methods: RwLock<BTreeMap<String, (Method, String)>>,
}

impl PlantNodes {
    /// Registers the namespaces and adds the types.
    pub fn new(
        context: &ServerContext,
        space: &mut AddressSpace,
        users: Authenticator,
        acknowledging: Acknowledging,
    ) -> Self {
        let mut namespaces = Vec::new();
        {
            let mut type_tree = context.type_tree.write();
            for uri in [NAMESPACE, MACHINERY, DEVICES] {
                let index = type_tree.namespaces_mut().add_namespace(uri);
                space.add_namespace(uri, index);
                namespaces.push(NamespaceMetadata {
                    namespace_uri: uri.into(),
                    namespace_index: index,
                    // The foundation's namespaces are not complete here.
                    is_namespace_subset: Some(uri != NAMESPACE),
                    ..NamespaceMetadata::default()
                });
            }
        }
        let names = Names {
            own: namespaces[0].namespace_index,
            machinery: namespaces[1].namespace_index,
            devices: namespaces[2].namespace_index,
        };
        types::insert(
            Types {
                namespace: names.own,
            },
            space,
        );
        Self {
            names,
            namespaces,
            users,
            acknowledging,
            methods: RwLock::default(),
        }
    }

    /// Does what a call asks for.
    async fn run(&self, user: &User, call: &MethodCall) -> Result<(), StatusCode> {
        let method_id = call.method_id().to_string();
        let found = self.methods.read().get(&method_id).cloned();
        let (method, tool) = found.ok_or(StatusCode::BadMethodInvalid)?;
        match method {
            Method::Acknowledge => self.acknowledge(user, tool, call.arguments()).await,
            Method::StartCheck => self.start_check(user, tool).await,
        }
    }

    /// Has a check made.
    async fn start_check(&self, user: &User, tool: String) -> Result<(), StatusCode> {
        let (history, user) = (self.acknowledging.history.clone(), user.clone());
        let start = move || start_check(&history, &user, Some(&tool));
        let started = tokio::task::spawn_blocking(start)
            .await
            .map_err(|_| StatusCode::BadInternalError)?;
        started.map_err(|why| match why {
            NotStarted::NotAllowed(_) => StatusCode::BadUserAccessDenied,
            NotStarted::Request(RequestError::Io { path, source }) => {
                tracing::warn!("opcua: {}: {source}", path.display());
                StatusCode::BadNoCommunication
            }
            NotStarted::Request(_) => StatusCode::BadInvalidState,
        })
    }

    /// Acknowledges the no-go that the arguments name, with the reason that they give.
    async fn acknowledge(
        &self,
        user: &User,
        tool: String,
        arguments: &[Variant],
    ) -> Result<(), StatusCode> {
        let [Variant::Int64(number), Variant::String(reason)] = arguments else {
            return Err(StatusCode::BadInvalidArgument);
        };
        let (number, reason) = (*number, reason.as_ref().to_owned());
        let (acknowledging, user) = (self.acknowledging.clone(), user.clone());
        let store = move || acknowledging.store(&user, number, Some(&tool), &reason);
        let stored = tokio::task::spawn_blocking(store)
            .await
            .map_err(|_| StatusCode::BadInternalError)?;
        stored.map_err(|refused| match refused {
            Refused::NotAllowed(_) => StatusCode::BadUserAccessDenied,
            Refused::NoReason => StatusCode::BadInvalidArgument,
            Refused::NotStanding(_) => StatusCode::BadNotFound,
            Refused::History(error) => {
                tracing::warn!("opcua: {error}");
                StatusCode::BadNoCommunication
            }
        })
    }
}

#[async_trait]
impl InMemoryNodeManagerImpl for PlantNodes {
    async fn init(&self, _space: &mut AddressSpace, _context: ServerContext) {}

    fn name(&self) -> &str {
        "flankscope-plant"
    }

    fn namespaces(&self) -> Vec<NamespaceMetadata> {
        self.namespaces.clone()
    }

    async fn call(
        &self,
        context: &RequestContext,
        _space: &RwLock<AddressSpace>,
        methods_to_call: &mut [&mut &mut MethodCall],
    ) -> Result<(), StatusCode> {
        let user = self
            .users
            .0
            .find(|users| users.named(&context.user_token().0));
        for call in methods_to_call {
            let done = match &user {
                Some(user) => self.run(user, call).await,
                None => Err(StatusCode::BadUserAccessDenied),
            };
            call.set_status(done.err().unwrap_or(StatusCode::Good));
        }
        Ok(())
    }
}

/// Shows these nodes instead of those before, and tells subscribers what changed.
pub fn show(
    manager: &Manager,
    subscriptions: &SubscriptionCache,
    before: &mut Shown,
    nodes: Vec<Node>,
) -> Result<(), StatusCode> {
    let order: Vec<String> = nodes.iter().map(|node| node.id.to_string()).collect();
    let mut next: Shown = order.iter().cloned().zip(nodes).collect();
    let mut gone = Vec::new();
    {
        let mut space = manager.address_space().write();
        let stays =
            |key: &String, node: &Node| next.get(key).is_some_and(|next| next.is_same_place(node));
        for (key, node) in before.iter().filter(|(key, node)| !stays(key, node)) {
            delete(&mut space, node);
            manager.inner().methods.write().remove(key);
            if matches!(node.kind, Kind::Variable { .. }) && !next.contains_key(key) {
                gone.push(node.id.clone());
            }
        }
        for key in &order {
            let Some(node) = next.get(key) else { continue };
            let is_there = before.get(key).is_some_and(|it| node.is_same_place(it));
            if !is_there && !space.node_exists(&node.id) {
                insert(&mut space, manager.inner().names, node);
                if let Kind::Method { tool, method } = &node.kind {
                    let mut methods = manager.inner().methods.write();
                    methods.insert(key.clone(), (*method, tool.clone()));
                }
            }
        }
    }
    let changed = next.iter().filter(|(key, node)| {
        let same = |before: &&Node| before.kind == node.kind;
        before.get(*key).filter(same).is_none()
    });
    let values: Vec<(&NodeId, DataValue)> = changed
        .filter_map(|(_, node)| Some((&node.id, node.data_value()?)))
        .collect();
    let values = values.into_iter().map(|(id, value)| (id, None, value));
    manager.set_values(subscriptions, values)?;
    let unknown = gone.iter().map(|id| {
        let value = DataValue {
            status: Some(StatusCode::BadNodeIdUnknown),
            ..DataValue::default()
        };
        (value, id, AttributeId::Value)
    });
    subscriptions.notify_data_change(unknown);
    std::mem::swap(before, &mut next);
    Ok(())
}

fn arguments_id(node: &Node) -> NodeId {
    let text = format!("{}/InputArguments", identifier(&node.id));
    NodeId::new(node.id.namespace, text)
}

fn identifier(id: &NodeId) -> &str {
    match &id.identifier {
        opcua::types::Identifier::String(text) => text.as_ref(),
        _ => "",
    }
}

fn delete(space: &mut AddressSpace, node: &Node) {
    if matches!(node.kind, Kind::Method { .. }) {
        space.delete(&arguments_id(node), true);
    }
    space.delete(&node.id, true);
}

fn insert(space: &mut AddressSpace, names: Names, node: &Node) {
    let name = QualifiedName::new(node.namespace, node.name.as_str());
    match &node.kind {
        Kind::Object {
            type_definition,
            has_events,
        } => {
            let notifier = match has_events {
                true => EventNotifier::SUBSCRIBE_TO_EVENTS,
                false => EventNotifier::empty(),
            };
            ObjectBuilder::new(&node.id, name, node.name.as_str())
                .event_notifier(notifier)
                .has_type_definition(*type_definition)
                .insert(space);
            if *has_events {
                let types = Types {
                    namespace: names.own,
                };
                let event = types.event();
                space.insert_reference(&node.id, &event, ReferenceTypeId::GeneratesEvent);
                let server = NodeId::from(ObjectId::Server);
                space.insert_reference(&server, &node.id, ReferenceTypeId::HasNotifier);
            }
        }
        Kind::Variable {
            type_definition,
            data_type,
            ..
        } => {
            VariableBuilder::new(&node.id, name, node.name.as_str())
                .data_type(data_type.clone())
                .value_rank(-1)
                .has_type_definition(*type_definition)
                .insert(space);
            // At once: somebody may read it before subscribers are told.
            if let (Some(NodeType::Variable(variable)), Some(value)) =
                (space.find_mut(&node.id), node.data_value())
            {
                variable.set_data_value(value);
            }
        }
        Kind::Method { method, .. } => {
            let argument = |name: &str, data_type: DataTypeId, description: &str| Argument {
                name: name.into(),
                data_type: data_type.into(),
                value_rank: -1,
                array_dimensions: None,
                description: LocalizedText::new("en", description),
            };
            let builder = MethodBuilder::new(&node.id, name, node.name.as_str())
                .executable(true)
                .user_executable(true);
            match method {
                Method::StartCheck => builder,
                Method::Acknowledge => {
                    let arguments = [
                        argument("Number", DataTypeId::Int64, "LatchedNumber as it was read"),
                        argument("Reason", DataTypeId::String, "1 to 200 characters"),
                    ];
                    builder.input_args(space, &arguments_id(node), &arguments)
                }
            }
            .insert(space);
        }
    }
    space.insert_reference(&node.parent, &node.id, node.reference);
}
