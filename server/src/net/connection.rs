//! One connection: what arrives on it goes to the world, what the world says goes out on it.

use std::future::Future;
use std::pin::pin;
use std::sync::atomic::Ordering;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bytes::Bytes;
use eyeline_protocol::codec::{self, ControlReader};
use eyeline_protocol::{Refusal, ServerControl};
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::flush::{CONTROL_QUEUE, Outgoing, Peer};
use super::{Handle, Place, Stage};
use crate::gate::Caller;
use crate::world::SessionId;

/// Sees a connection through from its handshake, which is not to begin before its turn has come, to its end.
pub(super) async fn serve(handle: Handle, incoming: quinn::Incoming, turn: Duration, mut place: Place) {
    if !turn.is_zero() {
        tokio::time::sleep(turn).await;
    }
    let greeting = handle.greeting();
    let connection = match timeout(greeting, async { incoming.await }).await {
        Ok(Ok(connection)) => connection,
        outcome => {
            handle.arrivals().counts.failed += 1;
            let error = outcome.map_or_else(|_| "it took too long".into(), |result| format!("{:?}", result.err()));
            return tracing::debug!(%error, "handshake failed");
        }
    };
    if handle.stage() != Stage::Serving {
        return turn_away(&connection, greeting, Refusal::ShuttingDown, super::ENDS).await;
    }
    let (control, outgoing) = mpsc::channel(CONTROL_QUEUE);
    let mut id = SessionId(0);
    let caller = Caller { address: Some(connection.remote_address().ip()), resume: resume_token() };
    handle.drive(|core, now| id = core.world.connect_from(now, caller));
    let peer = Peer::new(connection.clone(), control);
    let waiting = peer.waiting.clone();
    handle.lock().peers.insert(id, peer);
    if let Some(limit) = connection.max_datagram_size() {
        handle.with_world(|world| world.handle_datagram_limit(id, limit));
    }
    tracing::debug!(session = id.0, address = %connection.remote_address(), "connected");
    // A task of its own: what waits for a datagram is woken by each, and all that waits in one task is looked at again.
    let mut receiving = tokio::spawn(receive_datagrams(handle.clone(), id, connection.clone()));
    let reason = tokio::select! {
        reason = &mut receiving => reason.unwrap_or_else(|error| error.to_string()),
        reason = converse(&handle, id, &connection, outgoing, &waiting, &mut place) => reason,
        reason = wait_for_hello(&handle, id, greeting) => reason,
    };
    receiving.abort();
    tracing::debug!(session = id.0, %reason, "disconnected");
    connection.close(0u32.into(), reason.as_bytes());
    if handle.with_world(|world| world.is_spent(id)) {
        place.penalise();
    }
    handle.drive(|core, _| {
        core.hear(id);
        core.world.disconnect(id);
    });
    let mut core = handle.lock();
    core.peers.remove(&id);
    core.stats.note_path(&connection);
}

/// Tells a client that it is not let in, and why; the world never hears of it.
async fn turn_away(connection: &quinn::Connection, patience: Duration, refusal: Refusal, reason: &str) {
    let told = async {
        let (mut send, _receive) = connection.accept_bi().await?;
        let message = ServerControl::Refused { refusal, reason: reason.to_owned() };
        send.write_all(&codec::encode_control(&message)).await?;
        send.finish()?;
        let _ = timeout(HEARING, send.stopped()).await;
        anyhow::Ok(())
    };
    let _ = timeout(patience, told).await;
    connection.close(0u32.into(), reason.as_bytes());
}

/// For how long a client that is sent away may take to hear it.
pub(super) const HEARING: Duration = Duration::from_secs(1);

/// What a client may come back with. All zero, so that it can't, if the system has no chance to give.
fn resume_token() -> [u8; 16] {
    use ring::rand::SecureRandom;
    let mut token = [0; 16];
    match ring::rand::SystemRandom::new().fill(&mut token) {
        Ok(()) => token,
        Err(_) => [0; 16],
    }
}

/// Most datagrams of one connection that are handled before it is another's turn. One packet may hold 700 empty ones.
const BATCH: usize = 64;

async fn receive_datagrams(handle: Handle, id: SessionId, connection: quinn::Connection) -> String {
    loop {
        let first = match connection.read_datagram().await {
            Ok(datagram) => datagram,
            Err(error) => return error.to_string(),
        };
        // All that is here already is handled under one lock, and answered together.
        let mut handled = 1;
        handle.drive(|core, now| {
            core.take_in(id, first, now);
            while handled < BATCH
                && let Some(datagram) = datagram_at_hand(&connection)
            {
                core.take_in(id, datagram, now);
                handled += 1;
            }
        });
        if handled == BATCH {
            tokio::task::yield_now().await;
        }
    }
}

/// A datagram that has arrived already, if there is one.
fn datagram_at_hand(connection: &quinn::Connection) -> Option<Bytes> {
    let mut context = Context::from_waker(Waker::noop());
    match pin!(connection.read_datagram()).poll(&mut context) {
        Poll::Ready(datagram) => datagram.ok(),
        Poll::Pending => None,
    }
}

/// Ready when a client has not said hello in time; never for one that has.
async fn wait_for_hello(handle: &Handle, id: SessionId, greeting: Duration) -> String {
    tokio::time::sleep(greeting).await;
    if handle.with_world(|world| world.is_admitted(id)) {
        std::future::pending::<()>().await;
    }
    handle.arrivals().counts.never_in += 1;
    "no hello".into()
}

async fn converse(
    handle: &Handle,
    id: SessionId,
    connection: &quinn::Connection,
    mut outgoing: mpsc::Receiver<Outgoing>,
    waiting: &std::sync::atomic::AtomicUsize,
    place: &mut Place,
) -> String {
    let (mut send, mut receive) = match connection.accept_bi().await {
        Ok(stream) => stream,
        Err(error) => return error.to_string(),
    };
    let reading = async {
        let mut reader = ControlReader::of_client();
        let mut is_first = true;
        loop {
            match receive.read_chunk(16 * 1024, true).await {
                Ok(Some(chunk)) => reader.push(&chunk.bytes),
                // The client has said all it will; it may still listen.
                Ok(None) => return std::future::pending::<String>().await,
                Err(error) => return error.to_string(),
            }
            loop {
                match reader.next_message() {
                    Ok(Some(message)) => {
                        if std::mem::take(&mut is_first) {
                            handle.check_token(&message).await;
                        }
                        handle.drive(|core, now| {
                            core.hear(id);
                            core.world.handle_control(id, &message, now);
                            if core.world.is_admitted(id) {
                                place.let_in();
                            }
                        });
                    }
                    Ok(None) => break,
                    Err(error) => {
                        // Counted and told; writing closes the connection once the client has it.
                        handle.drive(|core, _| core.world.handle_broken_control(id, &error));
                        return std::future::pending::<String>().await;
                    }
                }
            }
        }
    };
    let writing = async {
        let mut sending: Option<tokio::task::JoinHandle<()>> = None;
        while let Some(message) = outgoing.recv().await {
            match message {
                Outgoing::Control(bytes) => {
                    if let Err(error) = send.write_all(&bytes).await {
                        return error.to_string();
                    }
                    waiting.fetch_sub(bytes.len(), Ordering::Relaxed);
                }
                Outgoing::WorldBytes => {
                    // One at a time: who asks again while it is under way gets no second copy.
                    if sending.as_ref().is_none_or(|sending| sending.is_finished()) {
                        let (connection, model) = (connection.clone(), handle.model.clone());
                        sending = Some(tokio::spawn(async move { send_world(&connection, model).await }));
                    }
                }
                Outgoing::Close(reason) => {
                    // Wait until the peer has it all, or has gone.
                    let _ = send.finish();
                    let _ = timeout(HEARING, send.stopped()).await;
                    return reason;
                }
            }
        }
        "closed".into()
    };
    tokio::select! {
        reason = reading => reason,
        reason = writing => reason,
    }
}

async fn send_world(connection: &quinn::Connection, model: Bytes) {
    let sent = async {
        let mut stream = connection.open_uni().await?;
        stream.set_priority(-1)?;
        // As a chunk, of which QUIC keeps a reference and no copy: a thousand who join share one model.
        stream.write_chunk(model).await?;
        stream.finish()?;
        anyhow::Ok(())
    };
    if let Err(error) = sent.await {
        tracing::debug!(%error, "the world was not sent");
    }
}
