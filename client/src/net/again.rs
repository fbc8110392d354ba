//! Comes back when the connection is lost, for as long as the server waits.

use std::future::Future;
use std::net::SocketAddr;
use std::time::Duration;

use eyeline_protocol::{Continuity, LocalTime};

use super::{Connection, Driver, Endpoint, NetError, Summary, run_headless};

/// The first pause between two tries, and the longest.
const PAUSE: Duration = Duration::from_millis(250);
const PAUSE_MAX: Duration = Duration::from_secs(4);

/// Runs a client as [`run_headless`] does, and comes back to its avatars when the connection is lost: the server keeps them
/// for a while, and so does the client what it holds.
///
/// # Errors
/// If the server ends or sends us away, or can't be reached, or has forgotten us, until the grace that its welcome told of
/// is over.
pub async fn run_resuming(
    endpoint: &Endpoint,
    address: SocketAddr,
    connection: &mut Connection,
    driver: &mut dyn Driver,
    period: Duration,
    first: LocalTime,
    shutdown: impl Future<Output = ()>,
) -> Result<Summary, NetError> {
    tokio::pin!(shutdown);
    let mut summary = Summary { next: first, ..Summary::default() };
    loop {
        let ran = run_headless(connection, driver, period, summary.next, &mut shutdown).await;
        let lost = match ran {
            Ok(ran) => {
                let (frames, skipped) = (summary.frames + ran.frames, summary.skipped + ran.skipped);
                return Ok(Summary { frames, skipped, ..ran });
            }
            Err(NetError::Lost(reason)) => reason,
            Err(error) => return Err(error),
        };
        tokio::select! {
            () = &mut shutdown => return Ok(summary),
            back = come_back(endpoint, address, connection, lost) => back?,
        }
        summary.next = connection.clock().now();
    }
}

/// Tries until the server's grace is over.
async fn come_back(
    endpoint: &Endpoint,
    address: SocketAddr,
    connection: &mut Connection,
    lost: String,
) -> Result<(), NetError> {
    let grace = connection.session.welcome().map_or(0, |welcome| welcome.grace_millis);
    let until = connection.clock().now() + Duration::from_millis(u64::from(grace));
    let mut pause = PAUSE;
    tracing::warn!(reason = %lost, "the connection is lost; trying to come back");
    loop {
        match endpoint.resume(address, connection).await {
            Ok(()) => break,
            Err(error @ (NetError::Refused { .. } | NetError::Ended(_) | NetError::ServerFault(_))) => {
                return Err(error);
            }
            Err(error) if connection.clock().now() + pause >= until => {
                return Err(NetError::Lost(format!("{lost}; and there is no coming back: {error}")));
            }
            Err(error) => tracing::debug!(%error, "not yet"),
        }
        tokio::time::sleep(pause).await;
        pause = (pause * 2).min(PAUSE_MAX);
    }
    match connection.session.welcome().map(|welcome| welcome.continuity) {
        Some(Continuity::New) | None => Err(NetError::Lost(format!(
            "{lost}; the server has forgotten us: it began anew, or we were away for too long"
        ))),
        Some(_) => {
            tracing::info!("back again");
            Ok(())
        }
    }
}
