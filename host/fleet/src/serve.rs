//! A page of all presses: tiles by verdict, dies by strokes left, stations unlike the others, and every press's checks.
//!
//! It reads the lake and nothing else, and listens on this machine alone: a proxy before it lets in whom it knows, and encrypts.
//!
//! | file | holds |
//! |---|---|
//! | `standing` | what the lake said last, asked whenever a file is new |
//! | `answers` | rows of the questions |
//! | `hall` | the map |
//! | `views` | what the templates show; when a verdict stands |

mod answers;
mod hall;
mod standing;
mod views;

use std::net::SocketAddr;
use std::sync::Arc;

use askama::Template;
use axum::Router;
use axum::extract::{Query, Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::runtime::Handle;
use tokio::sync::{Semaphore, watch};

use crate::lake::Lake;
use crate::query::{ScalarValue, Snapshot};
use answers::{CheckRow, FlankRow};
pub use hall::{Hall, HallError, Place};
use standing::{Lines, Standing, asked};
use views::{CheckPage, Dies, Press, Presses, Stations};

/// Checks on a page, and days that it looks at: so many files are read.
const LISTED: usize = 50;
const DAYS: i64 = 14;
const DAY_MS: i64 = 86_400_000;
/// Questions at a time about single presses; more wait.
const MOST_ASKED: usize = 4;

/// Headers of every answer: nothing is loaded from elsewhere, shown inside another site, or kept by a cache.
const HEADERS: [(HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; form-action 'none'; \
         base-uri 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "same-origin"),
    (header::CACHE_CONTROL, "no-store"),
];

/// The checks of a station before a time, the newest first, each with the flank that is nearest to its limit.
const OF_PRESS: &str = "
SELECT simulated, history, epoch, check_number, date, stored_at, tool, serial, tool_cycles, check_verdict, reason, tooth, flank, patch,
    wear_um, u95_um, limit_um
FROM (
    SELECT *, row_number() OVER (PARTITION BY history, epoch, check_number
        ORDER BY limit_um - wear_um NULLS LAST, tooth, flank, patch) AS place_in_check
    FROM checks WHERE station = $1 AND date >= $2 AND date <= $3 AND stored_at < $4
)
WHERE place_in_check = 1
ORDER BY stored_at DESC, check_number DESC";

/// The flanks of a check.
const OF_CHECK: &str = "
SELECT * FROM checks WHERE station = $1 AND date = $2 AND history = $3 AND epoch = $4 AND check_number = $5
ORDER BY tooth, flank, patch";

/// When it is, and how long a verdict stands.
pub(crate) struct Times {
    now: Timestamp,
    stale_after: SignedDuration,
}

impl Times {
    /// How far a station's clock may be ahead of this one.
    const AHEAD: SignedDuration = SignedDuration::from_mins(2);

    fn age(&self, of: Timestamp) -> SignedDuration {
        self.now.duration_since(of)
    }

    /// Whether a time lies in the future.
    fn is_ahead(&self, of: Timestamp) -> bool {
        self.age(of) < -Self::AHEAD
    }

    fn is_stale(&self, of: Timestamp) -> bool {
        self.age(of) > self.stale_after
    }
}

/// What the routes share.
pub(crate) struct Site {
    address: SocketAddr,
    hall: Option<Hall>,
    stale_after: SignedDuration,
    engine: Handle,
    asking: Semaphore,
    standing: watch::Receiver<Arc<Standing>>,
    lines: watch::Receiver<Option<Arc<Lines>>>,
}

impl Site {
    /// A lake that said nothing for so long is not believed to say what stands.
    const SILENT: SignedDuration = SignedDuration::from_secs(60);

    fn times(&self) -> Times {
        Times {
            now: Timestamp::now(),
            stale_after: self.stale_after,
        }
    }

    async fn ask<T: serde::de::DeserializeOwned + Send + 'static>(
        &self,
        question: impl Into<String>,
        values: Vec<ScalarValue>,
    ) -> Result<Vec<T>, Failed> {
        let snapshot: Option<Arc<Snapshot>> = self.standing.borrow().snapshot.clone();
        let snapshot =
            snapshot.ok_or_else(|| Failed::Because("the lake was not read yet".into()))?;
        let _turn = self.asking.acquire().await;
        let answer = asked(&self.engine, snapshot, question, values).await;
        answer.map_err(Failed::Because)
    }
}

/// How a lake is shown.
#[derive(Debug)]
pub struct Settings {
    pub lake: Lake,
    /// Where the presses stand.
    pub hall: Option<Hall>,
    /// How long a verdict stands.
    pub stale_after: SignedDuration,
}

/// Serves pages until the process ends. Questions are answered by the threads of `engine`, not by those that serve.
///
/// # Errors
/// The listener has no address.
pub async fn serve(
    listener: TcpListener,
    settings: Settings,
    engine: Handle,
) -> std::io::Result<()> {
    let (tell, standing) = watch::channel(Arc::new(Standing::default()));
    let (tell_lines, lines) = watch::channel(None);
    tokio::spawn(standing::follow(settings.lake, engine.clone(), tell));
    tokio::spawn(standing::follow_lines(
        standing.clone(),
        engine.clone(),
        tell_lines,
    ));
    let site = Arc::new(Site {
        address: listener.local_addr()?,
        hall: settings.hall,
        stale_after: settings.stale_after,
        engine,
        asking: Semaphore::new(MOST_ASKED),
        standing,
        lines,
    });
    let routes = Router::new()
        .route("/", get(presses))
        .route("/board", get(board))
        .route("/dies", get(dies))
        .route("/stations", get(stations))
        .route("/press", get(press))
        .route("/check", get(check))
        .fallback(async || Failed::NotThere)
        .layer(middleware::from_fn_with_state(
            Arc::clone(&site),
            of_this_site,
        ))
        .with_state(site);
    axum::serve(listener, routes).await
}

/// Why a page cannot be shown.
enum Failed {
    NotThere,
    Because(String),
}

impl From<askama::Error> for Failed {
    fn from(error: askama::Error) -> Self {
        Self::Because(error.to_string())
    }
}

impl IntoResponse for Failed {
    fn into_response(self) -> Response {
        match self {
            Self::NotThere => (StatusCode::NOT_FOUND, "there is no such page\n".into()),
            Self::Because(why) => (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n")),
        }
        .into_response()
    }
}

/// Refuses what is addressed to another name, so that another site's name that was pointed here reads nothing; adds [`HEADERS`].
async fn of_this_site(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let host = request.headers().get(header::HOST);
    let host = host.and_then(|host| host.to_str().ok());
    let names = [
        site.address.to_string(),
        format!("localhost:{}", site.address.port()),
    ];
    let is_here = host.is_some_and(|host| names.iter().any(|name| name.eq_ignore_ascii_case(host)));
    let mut answer = match is_here {
        true => next.run(request).await,
        false => {
            let why = format!(
                "this address is served as {}; a proxy must say so in Host\n",
                names.join(" or ")
            );
            (StatusCode::MISDIRECTED_REQUEST, why).into_response()
        }
    };
    for (name, value) in HEADERS {
        answer
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    answer
}

async fn presses(State(site): State<Arc<Site>>) -> Result<Html<String>, Failed> {
    let board = views::board(&site, &site.standing.borrow())?;
    Ok(Html(Presses { board }.render()?))
}

async fn board(State(site): State<Arc<Site>>) -> Result<Html<String>, Failed> {
    Ok(Html(views::board(&site, &site.standing.borrow())?))
}

async fn dies(State(site): State<Arc<Site>>) -> Result<Html<String>, Failed> {
    let lines = site.lines.borrow().clone();
    let page = Dies::of(&site, &site.standing.borrow(), lines.as_deref());
    Ok(Html(page.render()?))
}

async fn stations(State(site): State<Arc<Site>>) -> Result<Html<String>, Failed> {
    let lines = site.lines.borrow().clone();
    let page = Stations::of(&site.standing.borrow(), lines.as_deref());
    Ok(Html(page.render()?))
}

#[derive(Deserialize)]
struct OfPress {
    station: String,
    /// Milliseconds since 1970.
    before: Option<i64>,
}

async fn press(
    State(site): State<Arc<Site>>,
    Query(of): Query<OfPress>,
) -> Result<Html<String>, Failed> {
    let last = {
        let standing = site.standing.borrow();
        let mut presses = standing.presses.iter();
        presses
            .find(|press| press.station == of.station)
            .map(|press| press.check.stored_at)
    };
    let last_ms = last.ok_or(Failed::NotThere)?.as_millisecond();
    let before_ms = of.before.unwrap_or(last_ms + 1).clamp(0, last_ms + 1);
    let day = |ms: i64| i32::try_from(ms.div_euclid(DAY_MS)).ok();
    let from_ms = before_ms - DAYS * DAY_MS;
    let values = vec![
        ScalarValue::Utf8(Some(of.station.clone())),
        ScalarValue::Date32(day(from_ms)),
        ScalarValue::Date32(day(before_ms)),
        ScalarValue::TimestampMillisecond(Some(before_ms), Some("UTC".into())),
    ];
    let checks: Vec<CheckRow> = site
        .ask(format!("{OF_PRESS} LIMIT {LISTED}"), values)
        .await?;
    // The next page begins where this one ends: after a full page its last check, else the days that were looked at.
    let next_ms = match checks.last() {
        Some(oldest) if checks.len() == LISTED => oldest.stored_at.as_millisecond(),
        _ => from_ms,
    };
    Ok(Html(
        Press::of(&of.station, &checks, DAYS, next_ms).render()?,
    ))
}

#[derive(Deserialize)]
struct OfCheck {
    station: String,
    date: String,
    history: String,
    epoch: String,
    number: i64,
}

async fn check(
    State(site): State<Arc<Site>>,
    Query(of): Query<OfCheck>,
) -> Result<Html<String>, Failed> {
    let date: jiff::civil::Date = of.date.parse().map_err(|_| Failed::NotThere)?;
    let days = date
        .since(jiff::civil::date(1970, 1, 1))
        .map_err(|_| Failed::NotThere)?;
    let text = |text: &str| ScalarValue::Utf8(Some(text.to_owned()));
    let values = vec![
        text(&of.station),
        ScalarValue::Date32(Some(days.get_days())),
        text(&of.history),
        text(&of.epoch),
        ScalarValue::Int64(Some(of.number)),
    ];
    let rows: Vec<FlankRow> = site.ask(OF_CHECK, values).await?;
    let page = CheckPage::of(&of.station, &rows).ok_or(Failed::NotThere)?;
    Ok(Html(page.render()?))
}
