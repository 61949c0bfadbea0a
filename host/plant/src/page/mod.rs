//! The page: what stands, live; every check; a tool's history; acknowledging a no-go; and the metrics. Each route but `/healthz` and
//! `/login` wants a token.
//!
//! | file | holds |
//! |---|---|
//! | `entry` | who comes in: token, host name, headers of every answer |
//! | `users` | who has a token: seen, given and revoked by an admin |
//! | `language` | English or German, as the browser wants |
//! | `views` | what the templates show |

mod entry;
mod language;
mod users;
mod views;

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use askama::Template;
use axum::Router;
use axum::extract::{DefaultBodyLimit, Extension, Form, Path, Query, State};
use axum::http::{StatusCode, header};
use axum::middleware;
use axum::response::sse::{Event, Sse};
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::{get, post};
use flankscope_foundation::clock::BootTime;
use flankscope_metrology::verdict::Word;
use flankscope_record::check_request::RequestError;
use flankscope_record::history::{Forecast, History, HistoryError, series};
use flankscope_record::seal::Seals;
use flankscope_report::history_html;
use serde::Deserialize;
use tokio::sync::watch;
use tokio::time::interval;
use tokio_stream::wrappers::{IntervalStream, WatchStream};
use tokio_stream::{Stream, StreamExt};

use crate::access::{Role, User, UsersError, UsersFile};
use crate::acknowledge::{Acknowledging, MOST_REASON, Refused};
use crate::history::HistoryFile;
use crate::live::Live;
use crate::metrics;
use crate::settings::Settings;
use crate::start_check::{NotStarted, start_check};
use crate::statement::{Moment, Standing, StationStatement};
pub use entry::Names;
use language::Language;
use views::{Board, CheckPage, List};

/// Checks on one page of the list.
const LISTED: u32 = 50;
/// Largest body of a request, bytes: a token, or a reason.
const MOST_BODY: usize = 4096;
/// Interval at which a page hears that its connection stands, and asks for the board anew.
const TICK: Duration = Duration::from_secs(5);

/// What the routes share.
#[derive(Debug)]
pub struct Site {
    users: UsersFile,
    names: Names,
    reports: Option<PathBuf>,
    standing: watch::Receiver<Arc<Standing>>,
    live: watch::Receiver<Live>,
    acknowledging: Acknowledging,
    /// For what is asked; the thread that follows the history has one of its own and is not held up.
    history: Mutex<HistoryFile>,
}

impl Site {
    /// A site that is reached under these names.
    pub fn new(
        settings: &Settings,
        names: Names,
        users: UsersFile,
        seals: Seals,
        (standing, live): (watch::Receiver<Arc<Standing>>, watch::Receiver<Live>),
    ) -> Self {
        Self {
            users,
            names,
            reports: settings.reports.clone(),
            standing,
            live,
            acknowledging: Acknowledging {
                history: settings.history.clone(),
                seals: seals.clone(),
            },
            history: Mutex::new(HistoryFile::new(&settings.history, seals)),
        }
    }

    /// Statement of this moment.
    fn statement(&self) -> StationStatement {
        self.standing.borrow().statement(&Moment::now())
    }

    /// Reads the history where it holds up nobody.
    async fn ask<T: Send + 'static>(
        self: &Arc<Self>,
        question: impl FnOnce(&History) -> Result<T, HistoryError> + Send + 'static,
    ) -> Result<T, Failed> {
        if let Some(fault) = self.statement().fault {
            return Err(Failed::Because(fault.to_string()));
        }
        let site = Arc::clone(self);
        let answer = tokio::task::spawn_blocking(move || {
            let mut file = site.history.lock().unwrap_or_else(PoisonError::into_inner);
            let answer = file.opened().and_then(question);
            if answer.is_err() {
                file.close();
            }
            answer
        });
        Ok(answer.await??)
    }
}

/// Why a page cannot be shown.
enum Failed {
    NotThere,
    /// The token's role does not acknowledge.
    NotAllowed,
    /// The token's role does not give or revoke tokens.
    NoAdmin,
    Users(UsersError),
    /// An acknowledgement without a usable reason.
    NoReason,
    /// No unacknowledged no-go has this number: a newer one stands, or somebody was faster.
    NotStanding(i64),
    /// Nothing obeys a request for a check.
    NotStarted(RequestError),
    Because(String),
}

impl From<NotStarted> for Failed {
    fn from(why: NotStarted) -> Self {
        match why {
            NotStarted::NotAllowed(_) => Self::NotAllowed,
            NotStarted::Request(error @ RequestError::Io { .. }) => {
                Self::Because(error.to_string())
            }
            NotStarted::Request(error) => Self::NotStarted(error),
        }
    }
}

impl From<HistoryError> for Failed {
    fn from(error: HistoryError) -> Self {
        match error {
            HistoryError::NoSuchCheck { .. } => Self::NotThere,
            error => Self::Because(error.to_string()),
        }
    }
}

impl From<Refused> for Failed {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::NotAllowed(_) => Self::NotAllowed,
            Refused::NoReason => Self::NoReason,
            Refused::NotStanding(check) => Self::NotStanding(check),
            Refused::History(error) => error.into(),
        }
    }
}

impl From<UsersError> for Failed {
    fn from(error: UsersError) -> Self {
        Self::Users(error)
    }
}

impl From<askama::Error> for Failed {
    fn from(error: askama::Error) -> Self {
        Self::Because(error.to_string())
    }
}

impl From<tokio::task::JoinError> for Failed {
    fn from(error: tokio::task::JoinError) -> Self {
        Self::Because(error.to_string())
    }
}

impl IntoResponse for Failed {
    fn into_response(self) -> Response {
        match self {
            Self::NotThere => (StatusCode::NOT_FOUND, "there is no such page\n").into_response(),
            Self::NotAllowed => (
                StatusCode::FORBIDDEN,
                "this token may look, not acknowledge or start checks\n",
            )
                .into_response(),
            Self::NoAdmin => {
                let why = "this takes a token with the role admin\n";
                (StatusCode::FORBIDDEN, why).into_response()
            }
            Self::Users(error) => {
                let status = match &error {
                    UsersError::NoName { .. } => StatusCode::UNPROCESSABLE_ENTITY,
                    UsersError::Unknown { .. } => StatusCode::NOT_FOUND,
                    UsersError::Known { .. } | UsersError::LastAdmin { .. } => StatusCode::CONFLICT,
                    _ => StatusCode::SERVICE_UNAVAILABLE,
                };
                (status, format!("{error}\n")).into_response()
            }
            Self::NoReason => {
                let why = format!("a reason of 1 to {MOST_REASON} characters is needed\n");
                (StatusCode::UNPROCESSABLE_ENTITY, why).into_response()
            }
            Self::NotStanding(check) => {
                let why = format!(
                    "check {check} is not the no-go that stands now: look again, a newer one may, or somebody acknowledged it\n"
                );
                (StatusCode::CONFLICT, why).into_response()
            }
            Self::NotStarted(why) => (StatusCode::CONFLICT, format!("{why}\n")).into_response(),
            Self::Because(why) => {
                (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n")).into_response()
            }
        }
    }
}

/// All routes.
pub fn routes(site: Arc<Site>) -> Router {
    let with_token = Router::new()
        .route("/", get(home))
        .route("/board", get(board))
        .route("/now", get(now))
        .route("/now/state", get(now_state))
        .route("/now/pictures", get(now_pictures))
        .route("/events", get(events))
        .route("/checks", get(checks))
        .route("/checks/{id}", get(check))
        .route("/checks/{id}/document", get(document))
        .route("/trend", get(trend))
        .route("/reports/{page}", get(report))
        .route("/metrics", get(scraped))
        .route("/acknowledge", post(acknowledge))
        .route("/start-check", post(started))
        .route("/users", get(users::shown).post(users::given))
        .route("/users/revoke", post(users::revoked))
        .layer(middleware::from_fn_with_state(
            Arc::clone(&site),
            entry::with_token,
        ));
    Router::new()
        .merge(with_token)
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/login", post(entry::login))
        .route("/logout", post(entry::logout))
        .layer(DefaultBodyLimit::max(MOST_BODY))
        .layer(middleware::from_fn_with_state(
            Arc::clone(&site),
            entry::of_this_site,
        ))
        .with_state(site)
}

/// An acknowledgement as the page sends it: of which no-go, and why it may be cleared.
#[derive(Deserialize)]
struct Acknowledged {
    check: i64,
    reason: String,
}

/// Stores who acknowledged a no-go and why; a watch that runs obeys it, and checks again at the next opening.
async fn acknowledge(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    Form(form): Form<Acknowledged>,
) -> Result<Redirect, Failed> {
    let acknowledging = site.acknowledging.clone();
    let stored = move || acknowledging.store(&user, form.check, None, &form.reason);
    tokio::task::spawn_blocking(stored).await??;
    Ok(Redirect::to("/"))
}

/// Asks the watch for a check at the next opening.
async fn started(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
) -> Result<Redirect, Failed> {
    let history = site.acknowledging.history.clone();
    let start = move || start_check(&history, &user, None);
    tokio::task::spawn_blocking(start).await??;
    Ok(Redirect::to("/"))
}

type Shown = Result<Html<String>, Failed>;

async fn home(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    lang: Language,
) -> Shown {
    let board = board_now(&site, &user, lang)?;
    let (now, pictures) = (state_of(&site, lang).await?, pictures_of(&site, lang)?);
    let has_map3d = match &site.reports {
        Some(folder) => tokio::fs::try_exists(views::map3d(folder)).await,
        None => Ok(false),
    };
    let home = views::Home {
        lang,
        board,
        now,
        pictures,
        has_map3d: has_map3d.unwrap_or(false),
        acknowledges: user.role.acknowledges(),
        is_admin: user.role == Role::Admin,
    };
    Ok(Html(home.render()?))
}

async fn board(
    State(site): State<Arc<Site>>,
    Extension(user): Extension<User>,
    lang: Language,
) -> Shown {
    Ok(Html(board_now(&site, &user, lang)?))
}

/// State and pictures of the watch, as a page of its own.
async fn now(State(site): State<Arc<Site>>, lang: Language) -> Shown {
    let pictures = pictures_of(&site, lang)?;
    Ok(Html(state_of(&site, lang).await? + &pictures))
}

async fn now_state(State(site): State<Arc<Site>>, lang: Language) -> Shown {
    Ok(Html(state_of(&site, lang).await?))
}

async fn now_pictures(State(site): State<Arc<Site>>, lang: Language) -> Shown {
    Ok(Html(pictures_of(&site, lang)?))
}

async fn state_of(site: &Site, lang: Language) -> Result<String, askama::Error> {
    let history = site.acknowledging.history.clone();
    let free_bytes = tokio::task::spawn_blocking(move || free_bytes(&history)).await;
    let live = site.live.borrow().clone();
    views::Now::new(&live, &BootTime::now(), free_bytes.ok().flatten(), lang).render()
}

fn pictures_of(site: &Site, lang: Language) -> Result<String, askama::Error> {
    let pictures = Arc::clone(&site.live.borrow().pictures);
    views::LastPictures { lang, pictures }.render()
}

/// What the disk with this file has free for its user.
fn free_bytes(file: &std::path::Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(file).ok()?;
    Some(disk.f_bavail * disk.f_frsize)
}

fn board_now(site: &Site, user: &User, lang: Language) -> Result<String, askama::Error> {
    Board::new(&site.statement(), user.role.acknowledges(), lang).render()
}

/// A line at every change, and at least every [`TICK`]: the page then asks for the board, whose ages have changed, or for what the
/// watch does now or its pictures. The line itself proves nothing: only the answer to a question does.
async fn events(
    State(site): State<Arc<Site>>,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let changes = WatchStream::new(site.standing.clone()).map(|_| "changed");
    let mut pictures = Arc::clone(&site.live.borrow().pictures);
    let live = WatchStream::new(site.live.clone()).map(move |live| {
        let is_same = Arc::ptr_eq(&pictures, &live.pictures);
        pictures = live.pictures;
        if is_same { "live" } else { "pictures" }
    });
    let ticks = IntervalStream::new(interval(TICK)).map(|_| "tick");
    Sse::new(
        changes
            .merge(live)
            .merge(ticks)
            .map(|what| Ok(Event::default().data(what))),
    )
}

#[derive(Deserialize)]
struct Filter {
    tool: Option<String>,
    verdict: Option<Word>,
    before: Option<i64>,
}

async fn checks(
    State(site): State<Arc<Site>>,
    lang: Language,
    Query(filter): Query<Filter>,
) -> Shown {
    let Filter {
        tool,
        verdict,
        before,
    } = filter;
    let tool = tool.filter(|tool| !tool.is_empty());
    let wanted_tool = tool.clone();
    let (tools, listed) = site
        .ask(move |history| {
            let listed = history.listed(wanted_tool.as_deref(), verdict, before, LISTED)?;
            Ok((history.tools()?, listed))
        })
        .await?;
    let more = listed.last().filter(|_| listed.len() == LISTED as usize);
    let page = List {
        lang,
        more: more.map(|check| check.id),
        tools,
        tool: tool.unwrap_or_default(),
        verdict,
        checks: listed,
    };
    Ok(Html(page.render()?))
}

async fn check(State(site): State<Arc<Site>>, lang: Language, Path(id): Path<i64>) -> Shown {
    let check = site.ask(move |history| history.check(id)).await?;
    let report = match &site.reports {
        Some(folder) => views::report_of(folder.clone(), id).await,
        None => None,
    };
    let page = CheckPage {
        lang,
        check,
        report,
    };
    Ok(Html(page.render()?))
}

async fn document(
    State(site): State<Arc<Site>>,
    Path(id): Path<i64>,
) -> Result<impl IntoResponse, Failed> {
    let document = site.ask(move |history| history.document(id)).await?;
    Ok(([(header::CONTENT_TYPE, "application/json")], document))
}

#[derive(Deserialize)]
struct OfTool {
    tool: String,
}

async fn trend(State(site): State<Arc<Site>>, Query(OfTool { tool }): Query<OfTool>) -> Shown {
    let page = site
        .ask(move |history| {
            let checks = history.checks(&tool)?;
            let acknowledgements = history.acknowledgements(&tool)?;
            let forecasts: Vec<_> = series(&checks).into_iter().map(Forecast::of).collect();
            Ok((!checks.is_empty())
                .then(|| history_html(&tool, &checks, &acknowledgements, &forecasts)))
        })
        .await?;
    Ok(Html(page.ok_or(Failed::NotThere)??))
}

/// A page that the instrument wrote beside the history.
async fn report(State(site): State<Arc<Site>>, Path(page): Path<String>) -> Shown {
    let folder = site.reports.clone().ok_or(Failed::NotThere)?;
    Ok(Html(
        views::report_page(folder, page)
            .await
            .ok_or(Failed::NotThere)?,
    ))
}

async fn scraped(State(site): State<Arc<Site>>) -> Response {
    let live = site.live.borrow().clone();
    let live = live.current(&BootTime::now());
    match metrics::text(&site.statement(), live) {
        Ok(text) => ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], text).into_response(),
        Err(error) => Failed::Because(error.to_string()).into_response(),
    }
}

/// Whether the page says that a die is good.
#[cfg(test)]
pub fn says_good(station: &StationStatement, tool: &str) -> bool {
    let board = Board::new(station, false, Language::English);
    board.says_good(tool)
}
