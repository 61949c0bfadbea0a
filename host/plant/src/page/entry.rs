//! Who comes in. A browser keeps the token in a cookie that scripts cannot read and other sites cannot send; a program sends it as
//! `Authorization: Bearer TOKEN`.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use askama::Template;
use axum::extract::{Form, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{Html, IntoResponse, Redirect, Response};
use serde::Deserialize;

use super::Site;
use super::language::Language;
use super::views::Login;
use crate::places::Place;

const COOKIE: &str = "flankscope_token";

/// Headers of every answer: nothing is loaded from elsewhere, shown inside another site, or kept by a cache.
const HEADERS: [(HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; connect-src 'self'; \
         form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "same-origin"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Port that a browser leaves out.
const HTTPS: u16 = 443;

/// An address as a browser spells it.
fn host_of(ip: IpAddr) -> String {
    match ip {
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

/// Names under which this site is reached. A page of another site whose name was pointed at this address is refused.
#[derive(Debug)]
pub struct Names {
    hosts: Vec<String>,
    /// Whether browsers reach it through TLS alone.
    tls: bool,
}

impl Names {
    /// A page at `address`, which browsers reach under `name` if there is one; `encrypts` if it does so itself.
    pub fn new(address: SocketAddr, name: Option<&str>, encrypts: bool) -> Self {
        let mut hosts = vec![address.to_string(), format!("localhost:{}", address.port())];
        hosts.extend(name.map(str::to_owned));
        if encrypts {
            // No proxy takes the port away; browsers leave out the usual one.
            hosts.extend(name.map(|name| format!("{name}:{}", address.port())));
            if address.port() == HTTPS {
                hosts.extend(["localhost".into(), host_of(address.ip())]);
            }
        }
        Self {
            hosts,
            tls: encrypts || name.is_some(),
        }
    }

    fn holds(&self, host: &str) -> bool {
        self.hosts
            .iter()
            .any(|known_host| known_host.eq_ignore_ascii_case(host))
    }
}

/// Refuses what is addressed to another name, and changes that another site's page asks for; adds [`HEADERS`].
pub async fn of_this_site(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let host = only(request.headers(), &header::HOST);
    let from = only(request.headers(), &header::ORIGIN);
    let is_change = !matches!(*request.method(), Method::GET | Method::HEAD);
    let mut answer = if !matches!(host, Only::Text(host) if site.names.holds(host)) {
        let why = "this address is served under another name ([page] name in plant.toml)\n";
        (StatusCode::MISDIRECTED_REQUEST, why).into_response()
    } else if is_change && !is_own(&from, &site.names) {
        (StatusCode::FORBIDDEN, "asked for by another site\n").into_response()
    } else {
        next.run(request).await
    };
    for (name, value) in HEADERS {
        answer
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    answer
}

/// Value of a header that may be sent once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Only<'a> {
    Missing,
    Text(&'a str),
    /// It is sent twice, or has bytes beyond ASCII.
    Unusable,
}

fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Only<'a> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (None, _) => Only::Missing,
        (Some(value), None) => value.to_str().map_or(Only::Unusable, Only::Text),
        (Some(_), Some(_)) => Only::Unusable,
    }
}

/// Whether the origin is a page of this site, or missing, as in requests of programs.
fn is_own(origin: &Only<'_>, names: &Names) -> bool {
    match origin {
        Only::Missing => true,
        Only::Text(origin) => {
            let host = origin.split_once("://").map_or(*origin, |(_, host)| host);
            names.holds(host)
        }
        Only::Unusable => false,
    }
}

/// Passes on requests with a token; the others get the page for entering one, with status 401.
pub async fn with_token(
    State(site): State<Arc<Site>>,
    lang: Language,
    mut request: Request,
    next: Next,
) -> Response {
    let user = token(request.headers()).and_then(|token| site.users.of_token(token));
    if let Some(user) = user {
        if let Some(place) = request.extensions().get::<Arc<Place>>() {
            place.prove();
        }
        request.extensions_mut().insert(user);
        return next.run(request).await;
    }
    unauthorised(request.uri(), false, lang)
}

fn unauthorised(wanted: &Uri, refused: bool, lang: Language) -> Response {
    let login = Login {
        lang,
        to: wanted.path_and_query().map_or("/", |to| to.as_str()),
        refused,
    };
    match login.render() {
        Ok(page) => (
            StatusCode::UNAUTHORIZED,
            [(header::WWW_AUTHENTICATE, "Bearer")],
            Html(page),
        )
            .into_response(),
        Err(_) => StatusCode::UNAUTHORIZED.into_response(),
    }
}

fn token(headers: &HeaderMap) -> Option<&str> {
    if let Some(bearer) = text(headers, &header::AUTHORIZATION) {
        // RFC 9110, 11.1: the name of a scheme is case-insensitive.
        let (scheme, token) = bearer.split_once(' ')?;
        return scheme.eq_ignore_ascii_case("Bearer").then_some(token);
    }
    let cookies = text(headers, &header::COOKIE)?.split(';');
    let mut named = cookies.filter_map(|cookie| cookie.trim().split_once('='));
    named
        .find(|(name, _)| *name == COOKIE)
        .map(|(_, token)| token)
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

#[derive(Deserialize)]
pub struct Entered {
    token: String,
    to: String,
}

/// Takes a token that was entered, and leads on to the page that was wanted.
pub async fn login(
    State(site): State<Arc<Site>>,
    lang: Language,
    Form(entered): Form<Entered>,
) -> Response {
    let token = entered.token.trim();
    // A path of this site: `//elsewhere` would be another one.
    let is_path = entered.to.starts_with('/') && !entered.to[1..].starts_with(['/', '\\']);
    let to: Option<Uri> = entered.to.parse().ok().filter(|_| is_path);
    let to = to.unwrap_or_default();
    let Some(user) = site.users.of_token(token) else {
        tracing::warn!("a token was refused");
        return unauthorised(&to, true, lang);
    };
    tracing::info!("{} came in", user.name);
    let secure = if site.names.tls { "; Secure" } else { "" };
    let cookie = format!("{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict{secure}");
    (
        [(header::SET_COOKIE, cookie)],
        Redirect::to(&to.to_string()),
    )
        .into_response()
}

/// Removes the token from the browser.
pub async fn logout() -> Response {
    let cookie = format!("{COOKIE}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0");
    ([(header::SET_COOKIE, cookie)], Redirect::to("/")).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bearer_token_is_read_whatever_the_case_of_its_scheme() {
        for (value, expected) in [
            ("Bearer abc", Some("abc")),
            ("bearer abc", Some("abc")),
            ("BEARER abc", Some("abc")),
            ("Basic abc", None),
            ("Bearerabc", None),
            ("abc", None),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::AUTHORIZATION, HeaderValue::from_static(value));
            assert_eq!(token(&headers), expected, "{value}");
        }
    }

    #[test]
    fn a_change_is_refused_for_an_origin_that_is_foreign_doubled_or_not_ascii() {
        let names = Names::new("127.0.0.1:8460".parse().unwrap(), None, false);
        for (origins, is_accepted) in [
            (&[][..], true),
            (&[&b"http://127.0.0.1:8460"[..]][..], true),
            (&[&b"https://evil.example"[..]], false),
            (&[&b"https://evil.example/\xff"[..]], false),
            (
                &[&b"http://127.0.0.1:8460"[..], b"http://127.0.0.1:8460"],
                false,
            ),
            (
                &[&b"http://127.0.0.1:8460"[..], b"https://evil.example"],
                false,
            ),
            (&[&b"null"[..]], false),
            (&[&b""[..]], false),
        ] {
            let mut headers = HeaderMap::new();
            for origin in origins {
                let origin = HeaderValue::from_bytes(origin).unwrap();
                headers.append(header::ORIGIN, origin);
            }
            let origin = only(&headers, &header::ORIGIN);
            assert_eq!(is_own(&origin, &names), is_accepted, "{origins:?}");
        }
    }
}
