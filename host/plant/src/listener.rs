//! Connections of the page: how many at a time, and how long one may take to say what it wants.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;
use tokio::time::timeout;
use tower_service::Service;

use crate::encryption::Encryption;
use crate::places::{Place, Places};

/// Connections at a time: people at screens, a metrics server, and room for those that never say anything. For one more, the longest
/// silent one without a token is closed.
const MOST_CONNECTIONS: usize = 1000;
/// Connections from one address. All clients of a proxy have one.
const MOST_PER_ADDRESS: usize = 500;
/// Time for a request's headers.
const HEADER_TIME: Duration = Duration::from_secs(10);
/// Time for a whole request with its body, until its answer begins.
const REQUEST_TIME: Duration = Duration::from_secs(20);
/// Memory for what a client sends, bytes a connection.
const MOST_BUFFERED: usize = 16 << 10;
/// Pause after a connection could not be accepted, for example for want of file descriptors.
const PAUSE: Duration = Duration::from_millis(100);

/// Serves pages until the process ends.
pub async fn serve(
    listener: TcpListener,
    encryption: Encryption,
    routes: Router,
) -> anyhow::Result<()> {
    let places = Places::new(MOST_CONNECTIONS, MOST_PER_ADDRESS);
    loop {
        let accepted = listener.accept().await.and_then(|(stream, from)| {
            let place = places.take(&stream, from)?;
            Ok((stream, place))
        });
        let (stream, place) = match accepted {
            Ok((stream, place)) => (stream, Arc::new(place)),
            Err(error) => {
                tracing::warn!(%error, "a connection was not accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let routes = routes.clone();
        let encryption = encryption.clone();
        tokio::spawn(async move {
            // One that does not agree on a key in time, or speaks plainly where that is not done, is closed.
            let Some(stream) = encryption.agree(stream).await else {
                return;
            };
            let service =
                service_fn(move |request| answer(routes.clone(), Arc::clone(&place), request));
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new())
                .header_read_timeout(HEADER_TIME)
                .max_buf_size(MOST_BUFFERED);
            // A connection that breaks is its client's affair.
            let _ = http.serve_connection(TokioIo::new(stream), service).await;
        });
    }
}

/// The answer to a request. The routes find the connection's place in it, and prove it with a token.
async fn answer(
    mut routes: Router,
    place: Arc<Place>,
    request: Request<Incoming>,
) -> Result<Response, Infallible> {
    let mut request = request.map(Body::new);
    request.extensions_mut().insert(place);
    match timeout(REQUEST_TIME, routes.call(request)).await {
        Ok(answer) => answer,
        Err(_) => {
            let why = "the request did not arrive in time\n";
            let closed = [(header::CONNECTION, "close")];
            Ok((StatusCode::REQUEST_TIMEOUT, closed, why).into_response())
        }
    }
}
