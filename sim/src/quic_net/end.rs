//! One end of a QUIC connection: its control stream, its datagrams, and what it wants done.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use bytes::Bytes;
use eyeline_protocol::WorldTime;
use eyeline_protocol::codec::ControlReader;
use eyeline_server::world::PathState;
use quinn_proto::{Connection, ConnectionHandle, Datagram, Dir, Event, StreamEvent, StreamId, VarInt};

use crate::virtual_net::Direction;
use crate::virtual_net::transport::Output;

/// One end of a connection, named by the direction in which it sends.
pub(super) struct End {
    pub handle: ConnectionHandle,
    pub connection: Connection,
    /// Control bytes that the stream has not taken yet.
    pub unwritten: VecDeque<u8>,
    direction: Direction,
    stream: Option<StreamId>,
    reader: ControlReader,
    is_unreadable: bool,
    is_connected: bool,
    is_over: bool,
    /// Why it closes, and when at the latest.
    closing: Option<(String, WorldTime)>,
    /// Whether the peer has all that was said.
    is_heard_out: bool,
    /// What is in quinn's buffer of datagrams, in order: quinn does not say which of them a packet carries.
    waiting: VecDeque<(WorldTime, Vec<u8>)>,
    waited_max: Duration,
    waiting_bytes: usize,
    buffer_bytes: usize,
    /// DATAGRAM frames sent so far.
    frames: u64,
    /// When it will be woken.
    armed: Option<WorldTime>,
}

/// How long the peer has to hear why it is sent away, as in the server's shell.
const GOODBYE: Duration = Duration::from_secs(1);

/// What quinn counts for a datagram in its buffer besides its bytes.
const DATAGRAM_OVERHEAD: usize = size_of::<Datagram>();

impl End {
    pub fn new(handle: ConnectionHandle, mut connection: Connection, direction: Direction) -> End {
        let buffer_bytes = connection.datagrams().send_buffer_space() + DATAGRAM_OVERHEAD;
        let reader = match direction {
            Direction::Up => ControlReader::default(),
            Direction::Down => ControlReader::of_client(),
        };
        End {
            handle,
            connection,
            unwritten: VecDeque::new(),
            direction,
            stream: None,
            reader,
            is_unreadable: false,
            is_connected: false,
            is_over: false,
            closing: None,
            is_heard_out: false,
            waiting: VecDeque::new(),
            waited_max: Duration::ZERO,
            waiting_bytes: 0,
            buffer_bytes,
            frames: 0,
            armed: None,
        }
    }

    /// Whether it can send.
    pub fn is_open(&self) -> bool {
        self.is_connected && !self.is_over
    }

    /// The direction in which the peer sends, and so in which this end is reached.
    fn inward(&self) -> Direction {
        match self.direction {
            Direction::Up => Direction::Down,
            Direction::Down => Direction::Up,
        }
    }

    /// Takes a datagram, as the shells do: the oldest that wait make room, and what is too large for the path is dropped.
    pub fn send_datagram(&mut self, bytes: Vec<u8>, now: WorldTime, dropped: &mut Vec<Vec<u8>>) {
        let size = bytes.len() + DATAGRAM_OVERHEAD;
        let fits = self.is_open() && self.connection.datagrams().max_size().is_some_and(|most| bytes.len() <= most);
        if !fits || size > self.buffer_bytes {
            return dropped.push(bytes);
        }
        while self.waiting_bytes + size > self.buffer_bytes {
            let Some((since, oldest)) = self.waiting.pop_front() else { break };
            self.waited_max = self.waited_max.max(now.since(since));
            self.waiting_bytes -= oldest.len() + DATAGRAM_OVERHEAD;
            dropped.push(oldest);
        }
        match self.connection.datagrams().send(Bytes::from(bytes.clone()), true) {
            Ok(()) => {
                self.waiting_bytes += size;
                self.waiting.push_back((now, bytes));
            }
            Err(_) => dropped.push(bytes),
        }
    }

    /// What QUIC knows of the path that it sends on.
    pub fn path(&self, now: WorldTime) -> PathState {
        let path = self.connection.stats().path;
        PathState {
            waited: self.waiting.front().map(|&(since, _)| now.since(since)),
            queued_bytes: self.waiting_bytes,
            window_bytes: path.cwnd,
            round_trip: path.rtt,
        }
    }

    /// Longest time that a datagram waited.
    pub fn waited_max(&self) -> Duration {
        self.waited_max
    }

    /// Closes once everything is said.
    pub fn close(&mut self, reason: &str, now: WorldTime) {
        // A client says goodbye by closing; a server's last words are why.
        let by = if self.direction == Direction::Up { now } else { now + GOODBYE };
        self.closing.get_or_insert((reason.to_owned(), by));
    }

    /// When a close is due that is not done yet.
    pub fn close_by(&self) -> Option<WorldTime> {
        self.closing.as_ref().filter(|_| !self.is_over).map(|(_, by)| *by)
    }

    /// Closes if it is time.
    pub fn close_if_due(&mut self, at: Instant, now: WorldTime, client: usize, out: &mut VecDeque<Output>) {
        let Some((reason, by)) = &self.closing else { return };
        if self.is_over || *by > now && !self.is_heard_out {
            return;
        }
        self.is_over = true;
        self.connection.close(at, VarInt::from_u32(0), Bytes::copy_from_slice(reason.as_bytes()));
        // A client that goes needs no telling.
        if self.direction == Direction::Down {
            out.push_back(Output::Over { client, direction: Direction::Up, reason: reason.clone() });
        }
    }

    /// Takes quinn's events; whether there were any.
    pub fn hear(&mut self, client: usize, out: &mut VecDeque<Output>) -> bool {
        let mut is_any = false;
        while let Some(event) = self.connection.poll() {
            is_any = true;
            match event {
                Event::Connected => self.connected(client, out),
                Event::DatagramReceived => {
                    while let Some(bytes) = self.connection.datagrams().recv() {
                        let (direction, bytes) = (self.inward(), bytes.to_vec());
                        out.push_back(Output::Datagram { client, direction, bytes });
                    }
                }
                Event::Stream(StreamEvent::Opened { dir: Dir::Bi }) => {
                    if self.stream.is_none() {
                        self.stream = self.connection.streams().accept(Dir::Bi);
                    }
                    self.read(client, out);
                }
                Event::Stream(StreamEvent::Readable { .. }) => self.read(client, out),
                Event::Stream(StreamEvent::Finished { .. } | StreamEvent::Stopped { .. }) => self.is_heard_out = true,
                Event::ConnectionLost { reason } => {
                    if !std::mem::replace(&mut self.is_over, true) {
                        let (direction, reason) = (self.inward(), reason.to_string());
                        out.push_back(Output::Over { client, direction, reason });
                    }
                }
                Event::HandshakeDataReady | Event::DatagramsUnblocked | Event::Stream(_) => {}
            }
        }
        // A goodbye before the connection stands has nobody to hear it.
        self.is_heard_out |= self.closing.is_some() && self.stream.is_none();
        is_any
    }

    fn connected(&mut self, client: usize, out: &mut VecDeque<Output>) {
        self.is_connected = true;
        match self.direction {
            Direction::Up => self.stream = self.connection.streams().open(Dir::Bi),
            Direction::Down => {
                let datagram_limit = self.connection.datagrams().max_size().unwrap_or_default();
                out.push_back(Output::Connected { client, datagram_limit });
            }
        }
    }

    fn read(&mut self, client: usize, out: &mut VecDeque<Output>) {
        let Some(stream) = self.stream.filter(|_| !self.is_unreadable) else { return };
        let mut stream = self.connection.recv_stream(stream);
        let Ok(mut chunks) = stream.read(true) else { return };
        while let Ok(Some(chunk)) = chunks.next(usize::MAX) {
            self.reader.push(&chunk.bytes);
        }
        // Sent with whatever goes next.
        let _ = chunks.finalize();
        let direction = self.inward();
        loop {
            match self.reader.next_message() {
                Ok(Some(message)) => out.push_back(Output::Control { client, direction, message }),
                Ok(None) => return,
                Err(error) => {
                    // What follows can't be read either.
                    self.is_unreadable = true;
                    return out.push_back(Output::Broken { client, direction, error });
                }
            }
        }
    }

    /// Writes what the control stream takes, and ends it after the last word.
    pub fn write(&mut self) {
        let Some(stream) = self.stream.filter(|_| self.is_open()) else { return };
        let mut stream = self.connection.send_stream(stream);
        while !self.unwritten.is_empty() {
            let (bytes, _) = self.unwritten.as_slices();
            match stream.write(bytes) {
                Ok(written) => drop(self.unwritten.drain(..written)),
                Err(_) => return,
            }
        }
        if self.closing.is_some() {
            // Fails if it was done already.
            let _ = stream.finish();
        }
    }

    /// Makes packets of all that may be sent now; whether there were any.
    pub fn transmit(
        &mut self,
        client: usize,
        (at, now): (Instant, WorldTime),
        packet: &mut Vec<u8>,
        out: &mut VecDeque<Output>,
    ) -> bool {
        let mut is_any = false;
        loop {
            packet.clear();
            let Some(transmit) = self.connection.poll_transmit(at, 1, packet) else { return is_any };
            is_any = true;
            let frames = self.connection.stats().frame_tx.datagram;
            let count = usize::try_from(frames - self.frames).unwrap_or(usize::MAX).min(self.waiting.len());
            debug_assert_eq!(count as u64, frames - self.frames, "quinn sends what it was given, in order");
            self.frames = frames;
            let longest = self.waiting.iter().take(count).map(|(since, _)| now.since(*since)).max();
            self.waited_max = self.waited_max.max(longest.unwrap_or_default());
            let carried: Vec<Vec<u8>> = self.waiting.drain(..count).map(|(_, bytes)| bytes).collect();
            self.waiting_bytes -= carried.iter().map(|bytes| bytes.len() + DATAGRAM_OVERHEAD).sum::<usize>();
            let bytes = packet[..transmit.size].to_vec();
            out.push_back(Output::Packet { client, direction: self.direction, bytes, carried });
        }
    }

    /// Notes when it will be woken; whether that is news.
    pub fn arm(&mut self, at: WorldTime) -> bool {
        let is_news = self.armed.is_none_or(|armed| at < armed);
        if is_news {
            self.armed = Some(at);
        }
        is_news
    }

    /// Whether this is the awaited wake-up, and not one that an earlier one has replaced.
    pub fn disarm(&mut self, now: WorldTime) -> bool {
        let is_it = self.armed == Some(now);
        if is_it {
            self.armed = None;
        }
        is_it
    }
}
