//! One connection of a [`super::Throng`]: its control stream, its datagrams and its timer.

use std::time::Instant;

use anyhow::bail;
use bytes::Bytes;
use eyeline_client::net::{Driver, LocalClock, NetError};
use eyeline_client::session::{Event as SessionEvent, Session};
use eyeline_protocol::codec::ControlReader;
use eyeline_protocol::{LocalTime, Refusal};
use quinn::udp::UdpSocketState;
use quinn_proto::{Connection, ConnectionHandle, Dir, Event, SendDatagramError, StreamEvent, StreamId, VarInt};

use super::{Looked, send};

/// What was heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// Nothing that changes anything.
    Nothing,
    /// The server has let us in.
    Welcome,
    /// It has heard our goodbye.
    Left,
}

pub(super) struct Link {
    pub handle: ConnectionHandle,
    pub connection: Connection,
    /// Whose it is.
    pub member: usize,
    /// Whether it waits to be looked after.
    pub is_touched: bool,
    /// Whether a goodbye was said, which the server answers by closing.
    pub is_leaving: bool,
    stream: Option<StreamId>,
    reader: ControlReader,
    /// Control bytes that the stream has not taken yet.
    unwritten: Vec<u8>,
    /// When it will be woken.
    armed: Option<Instant>,
}

impl Link {
    pub fn new(handle: ConnectionHandle, connection: Connection, member: usize) -> Link {
        Link {
            handle,
            connection,
            member,
            is_touched: false,
            is_leaving: false,
            stream: None,
            reader: ControlReader::default(),
            unwritten: Vec::new(),
            armed: None,
        }
    }

    /// Hands its session what has arrived; the session's answers that can't wait go at once.
    pub fn hear(
        &mut self,
        session: &mut Session,
        player: &mut dyn Driver,
        looked: &mut Looked,
        clock: LocalClock,
    ) -> anyhow::Result<Heard> {
        let was_waiting = session.is_waiting();
        let mut is_news = false;
        while let Some(event) = self.connection.poll() {
            match event {
                Event::Connected => {
                    self.stream = self.connection.streams().open(Dir::Bi);
                    self.say(session, clock.now());
                }
                Event::DatagramReceived => {
                    looked.at_news(session, player);
                    let occlusion = player.occlusion().filter(|_| looked.at_all);
                    while let Some(bytes) = self.connection.datagrams().recv() {
                        is_news = true;
                        session.handle_datagram(&bytes, occlusion, clock.now());
                    }
                }
                Event::Stream(StreamEvent::Readable { .. }) => {
                    self.read(session)?;
                    is_news = true;
                    looked.at_news(session, player);
                    if let Some(occlusion) = player.occlusion().filter(|_| looked.at_all) {
                        session.handle_news(occlusion);
                    }
                }
                Event::Stream(StreamEvent::Writable { .. }) => self.write(),
                Event::ConnectionLost { .. } if self.is_leaving => return Ok(Heard::Left),
                Event::ConnectionLost { reason } => bail!("connection lost: {reason}"),
                _ => {}
            }
        }
        if is_news {
            self.send_datagrams(|limit| session.poll_urgent(limit, clock.now()));
        }
        Ok(if was_waiting && !session.is_waiting() { Heard::Welcome } else { Heard::Nothing })
    }

    /// Takes what has arrived on a connection that is over.
    pub fn ignore(&mut self) -> anyhow::Result<Heard> {
        while self.connection.poll().is_some() {}
        Ok(Heard::Nothing)
    }

    fn read(&mut self, session: &mut Session) -> anyhow::Result<()> {
        let Some(stream) = self.stream else { return Ok(()) };
        let mut stream = self.connection.recv_stream(stream);
        if let Ok(mut chunks) = stream.read(true) {
            while let Ok(Some(chunk)) = chunks.next(usize::MAX) {
                self.reader.push(&chunk.bytes);
            }
            // Sent with whatever goes next.
            let _ = chunks.finalize();
        }
        while let Some(message) = self.reader.next_message()? {
            session.handle_control(&message);
        }
        match session.poll_fault() {
            Some(SessionEvent::Refused { refusal: Refusal::ShuttingDown, reason }) => {
                bail!("{}", NetError::Ended(reason))
            }
            Some(SessionEvent::Refused { reason, .. }) => bail!("the server refused us: {reason}"),
            Some(fault) => bail!("{}", fault.describe()),
            None => Ok(()),
        }
    }

    /// Says what its session has to say.
    pub fn say(&mut self, session: &mut Session, now: LocalTime) {
        if self.stream.is_none() {
            return;
        }
        while let Some(bytes) = session.poll_control() {
            self.unwritten.extend(bytes);
        }
        self.write();
        // Who comes back has much to say already, but nobody listens before hello is answered.
        if !session.is_waiting() {
            self.send_datagrams(|limit| session.poll_datagram(limit, now));
        }
    }

    fn write(&mut self) {
        let Some(stream) = self.stream.filter(|_| !self.unwritten.is_empty()) else { return };
        let mut stream = self.connection.send_stream(stream);
        while !self.unwritten.is_empty() {
            match stream.write(&self.unwritten) {
                Ok(written) => drop(self.unwritten.drain(..written)),
                Err(_) => return,
            }
        }
    }

    fn send_datagrams(&mut self, mut next: impl FnMut(usize) -> Option<Vec<u8>>) {
        let Some(limit) = self.connection.datagrams().max_size() else { return };
        while let Some(bytes) = next(limit) {
            match self.connection.datagrams().send(Bytes::from(bytes), true) {
                Ok(()) | Err(SendDatagramError::TooLarge | SendDatagramError::Blocked(_)) => {}
                Err(SendDatagramError::UnsupportedByPeer | SendDatagramError::Disabled) => return,
            }
        }
    }

    /// How far it has got, for one that takes too long.
    pub fn how_far(&self) -> String {
        let done =
            if self.connection.is_handshaking() { "the handshake has not ended" } else { "hello is not answered" };
        let path = self.connection.stats().path;
        format!("{done} ({} packets were sent, {} of them lost)", path.sent_packets, path.lost_packets)
    }

    /// Ends.
    pub fn part(&mut self, now: Instant, why: &'static [u8]) {
        self.connection.close(now, VarInt::from_u32(0), Bytes::from_static(why));
    }

    /// Sends all packets that may leave now.
    pub fn transmit(&mut self, udp: &UdpSocketState, socket: &tokio::net::UdpSocket, packet: &mut Vec<u8>) {
        let now = Instant::now();
        loop {
            packet.clear();
            let Some(transmit) = self.connection.poll_transmit(now, 1, packet) else { return };
            send(udp, socket, &transmit, packet);
        }
    }

    /// When it wants to be woken, if that is sooner than it will be.
    pub fn arm(&mut self) -> Option<Instant> {
        let wanted = self.connection.poll_timeout()?;
        let is_news = self.armed.is_none_or(|armed| wanted < armed);
        is_news.then(|| *self.armed.insert(wanted))
    }

    /// Whether this is the awaited wake-up, and not one that a sooner one has replaced.
    pub fn disarm(&mut self, at: Instant) -> bool {
        let is_it = self.armed == Some(at);
        if is_it {
            self.armed = None;
        }
        is_it
    }
}
