//! Connections of the page: how many at a time, and how long one may take to say what it wants.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::encryption::Encryption;

/// Connections at a time: people at screens, a metrics server, and room for those that never say anything.
const MOST_CONNECTIONS: usize = 1000;
/// Time for a request's headers.
const HEADER_TIME: Duration = Duration::from_secs(10);
/// Pause after a connection could not be accepted, for example for want of file descriptors.
const PAUSE: Duration = Duration::from_millis(100);

/// Serves pages until the process ends.
pub async fn serve(
    listener: TcpListener,
    encryption: Encryption,
    routes: Router,
) -> anyhow::Result<()> {
    let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let permit = Arc::clone(&room).acquire_owned().await?;
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a connection was not accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let service = TowerToHyperService::new(routes.clone());
        let encryption = encryption.clone();
        tokio::spawn(async move {
            let _permit = permit;
            // One that does not agree on a key in time, or speaks plainly where that is not done, is closed.
            let Some(stream) = encryption.agree(stream).await else {
                return;
            };
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new())
                .header_read_timeout(HEADER_TIME);
            // A connection that breaks is its client's affair.
            let _ = http.serve_connection(TokioIo::new(stream), service).await;
        });
    }
}
