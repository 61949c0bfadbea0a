//! Who comes in: a name of the users' file with its token as password. Nobody comes in anonymously.

use std::sync::Arc;

use async_trait::async_trait;
use opcua::server::ServerEndpoint;
use opcua::server::authenticator::{
    AuthManager, Password, UserToken, user_pass_security_policy_id,
};
use opcua::types::{Error, NodeId, StatusCode, UAString, UserTokenPolicy, UserTokenType};

use crate::access::UsersFile;

/// Asks the users' file at every login and every call that changes something: what an admin revoked is good for nothing.
#[derive(Clone)]
pub struct Authenticator(pub Arc<UsersFile>);

#[async_trait]
impl AuthManager for Authenticator {
    async fn authenticate_username_identity_token(
        &self,
        _endpoint: &ServerEndpoint,
        username: &str,
        password: &Password,
    ) -> Result<UserToken, Error> {
        let user = self.0.of_token(password.get());
        match user.filter(|user| user.name == username) {
            Some(user) => {
                tracing::info!("{} came in by OPC UA", user.name);
                Ok(UserToken(user.name.clone()))
            }
            None => {
                tracing::warn!("opcua: a user was refused");
                let why = "unknown user or wrong token";
                Err(Error::new(StatusCode::BadIdentityTokenRejected, why))
            }
        }
    }

    fn user_token_policies(&self, endpoint: &ServerEndpoint) -> Vec<UserTokenPolicy> {
        vec![UserTokenPolicy {
            policy_id: user_pass_security_policy_id(endpoint),
            token_type: UserTokenType::UserName,
            issued_token_type: UAString::null(),
            issuer_endpoint_url: UAString::null(),
            // As the channel's.
            security_policy_uri: UAString::null(),
        }]
    }

    /// The standard's own methods are for everybody, those of this server change something.
    fn is_user_executable(&self, token: &UserToken, method_id: &NodeId) -> bool {
        let user = || self.0.find(|users| users.named(&token.0));
        method_id.namespace == 0 || user().is_some_and(|user| user.role.acknowledges())
    }
}
