//! Who has a token: an admin sees it, gives new ones and revokes old ones. The file is the truth: every change reads it, writes it whole, and
//! counts from then on.

use std::path::Path;
use std::sync::Arc;

use askama::Template;
use axum::extract::{Extension, Form, State};
use axum::response::{Html, Redirect};
use serde::Deserialize;

use super::language::Language;
use super::views::UsersPage;
use super::{Failed, Shown, Site};
use crate::access::{Role, User, Users, UsersError};

/// Changes the file where it holds up nobody, if the user may.
async fn change<T: Send + 'static>(
    site: &Arc<Site>,
    user: &User,
    change: impl FnOnce(&Path) -> Result<T, UsersError> + Send + 'static,
) -> Result<T, Failed> {
    require_admin(user)?;
    let (site, user) = (Arc::clone(site), user.clone());
    let changed = move || {
        site.users.changed(|now, path| {
            // Whose role was taken away in the file meanwhile changes nothing.
            require_admin(now.named(&user.name).ok_or(Failed::NoAdmin)?)?;
            Ok(change(path)?)
        })
    };
    tokio::task::spawn_blocking(changed).await?
}

fn require_admin(user: &User) -> Result<(), Failed> {
    match user.role {
        Role::Admin => Ok(()),
        Role::View | Role::Acknowledge => Err(Failed::NoAdmin),
    }
}

fn page(site: &Site, lang: Language, user: &User, given: Option<(&str, &str)>) -> Shown {
    let users = site.users.now()?;
    let page = UsersPage {
        lang,
        users: users.all(),
        own: &user.name,
        given,
    };
    Ok(Html(page.render()?))
}

/// Names, roles, and since when.
pub async fn shown(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    lang: Language,
) -> Shown {
    require_admin(&user)?;
    page(&site, lang, &user, None)
}

#[derive(Deserialize)]
pub struct New {
    name: String,
    role: Role,
}

/// Gives a token, which the answer shows and nothing keeps.
pub async fn given(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    lang: Language,
    Form(New { name, role }): Form<New>,
) -> Shown {
    let name = name.trim().to_owned();
    let new = name.clone();
    let token = change(&site, &user, move |path| Users::add(path, &new, role)).await?;
    let word = role.word();
    tracing::info!("{} gave {name} a token with the role {word}", user.name);
    page(&site, lang, &user, Some((&name, &token)))
}

#[derive(Deserialize)]
pub struct Of {
    name: String,
}

/// Revokes a token.
pub async fn revoked(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    Form(Of { name }): Form<Of>,
) -> Result<Redirect, Failed> {
    let revoked_name = name.clone();
    change(&site, &user, move |path| Users::revoke(path, &revoked_name)).await?;
    tracing::info!("{} revoked the token of {name}", user.name);
    Ok(Redirect::to("/users"))
}
