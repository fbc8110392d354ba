//! Between cores and transport: what the world says goes to the transport, and what the transport wants is done.

use eyeline_client::session::Event as SessionEvent;
use eyeline_server::world::{Transmit, room};

use super::{Event, FNV, VirtualRun};
use crate::virtual_net::link::{Direction, Fate, Kind, VirtualLink};
use crate::virtual_net::observer::{Observer, Passing, Verdict};
use crate::virtual_net::transport::Output;

impl VirtualRun {
    /// Something has arrived whole.
    pub(super) fn arrives(
        &mut self,
        client: usize,
        direction: Direction,
        kind: Kind,
        bytes: &[u8],
        observer: &mut dyn Observer,
    ) {
        let passing = Passing { client, direction, kind, bytes, at: self.now };
        self.note(&passing);
        observer.arrives(&passing);
        match direction {
            Direction::Up => self.arrives_at_server(client, kind, bytes),
            Direction::Down => self.arrives_at_client(client, kind, bytes),
        }
    }

    /// The connection is over for the end that `direction` leads to.
    pub(super) fn over(&mut self, client: usize, direction: Direction, reason: String) {
        match direction {
            Direction::Up => self.world.disconnect(self.clients[client].id),
            Direction::Down => {
                self.clients[client].connected = false;
                self.clients[client].closed.get_or_insert(reason);
            }
        }
    }

    pub(super) fn drain_world(&mut self, observer: &mut dyn Observer) {
        // As the server's shell does.
        let tick = self.world.tick_period();
        loop {
            let (clients, transport, now) = (&self.clients, &self.transport, self.now);
            let room = |id| {
                let client = clients.iter().position(|client| client.id == id);
                let path = client.and_then(|client| transport.path(client, Direction::Down, now));
                path.map_or(usize::MAX, |path| room(path, tick))
            };
            let Some((id, transmit)) = self.world.poll_transmit_where(now, room) else { break };
            let Some(client) = self.client_of(id) else { continue };
            match transmit {
                Transmit::Control(bytes) => self.transport.send_control(client, Direction::Down, &bytes),
                Transmit::Datagram(bytes) => {
                    let (direction, kind, at) = (Direction::Down, Kind::Datagram, self.now);
                    observer.sent(&Passing { client, direction, kind, bytes: &bytes, at });
                    self.transport.send_datagram(client, direction, bytes, at);
                }
                // The model is not part of a virtual run: its clients have it.
                Transmit::WorldBytes => {}
                Transmit::Close(reason) => self.transport.close(client, Direction::Down, &reason, self.now),
            }
        }
    }

    /// Does all that the transport wants done now, and what comes of it.
    pub(super) fn pump(&mut self, observer: &mut dyn Observer) {
        while let Some(output) = self.transport.poll(self.now) {
            self.perform(output, observer);
            self.drain_world(observer);
        }
    }

    fn perform(&mut self, output: Output, observer: &mut dyn Observer) {
        let now = self.now;
        match output {
            Output::Packet { client, direction, bytes, carried } => {
                self.put(client, direction, bytes, &carried, observer);
            }
            Output::Reliable { client, direction, message } => {
                let (at, lost) = self.link(client, direction).control(message.len() + 4, now);
                for _ in 0..lost {
                    observer.lost(&Passing { client, direction, kind: Kind::Control, bytes: &message, at: now });
                }
                self.queue.push(at, Event::Control { client, direction, message });
            }
            Output::Goodbye { client, direction, reason } => {
                let (at, _) = self.link(client, direction).control(1, now);
                self.queue.push(at, Event::Over { client, direction, reason });
            }
            Output::Wake { client, direction, at } => self.queue.push(at.max(now), Event::Wake { client, direction }),
            Output::Connected { client, datagram_limit } => {
                let id = self.world.connect(now);
                self.clients[client].id = id;
                self.world.handle_datagram_limit(id, datagram_limit);
            }
            Output::Datagram { client, direction, bytes } => {
                self.arrives(client, direction, Kind::Datagram, &bytes, observer);
            }
            Output::Control { client, direction, message } => {
                self.arrives(client, direction, Kind::Control, &message, observer);
            }
            Output::Broken { client, direction: Direction::Up, error } => {
                self.world.handle_broken_control(self.clients[client].id, &error);
            }
            Output::Broken { client, direction: Direction::Down, error } => {
                self.clients[client].events.push(SessionEvent::ServerFault(error));
                self.hang_up(client);
            }
            Output::Dropped { client, direction, bytes } => {
                observer.lost(&Passing { client, direction, kind: Kind::Datagram, bytes: &bytes, at: now });
            }
            Output::Over { client, direction, reason } => self.over(client, direction, reason),
        }
    }

    /// Puts a packet on its way, or not, as the interceptor and the rules decide.
    fn put(
        &mut self,
        client: usize,
        direction: Direction,
        bytes: Vec<u8>,
        carried: &[Vec<u8>],
        observer: &mut dyn Observer,
    ) {
        let now = self.now;
        let verdict = match &mut self.interceptor {
            Some(interceptor) => {
                interceptor(&Passing { client, direction, kind: Kind::Datagram, bytes: &bytes, at: now })
            }
            None => Verdict::AsRuled,
        };
        let (verdict, bytes) = match verdict {
            Verdict::Rewrite(bytes) => (Verdict::AsRuled, bytes),
            verdict => (verdict, bytes),
        };
        let passing = |kind, bytes| Passing { client, direction, kind, bytes, at: now };
        let packet = passing(Kind::Datagram, &bytes);
        // Drawn whatever the verdict, so that an interception changes nothing else.
        let ruled = self.link(client, direction).datagram(bytes.len(), now);
        let (first, second) = match verdict {
            Verdict::AsRuled | Verdict::Rewrite(_) => ruled,
            Verdict::Instead(fate) => (fate, None),
            Verdict::Twice(first, second) => (Fate::Deliver(first), Some(Fate::Deliver(second))),
        };
        if first == Fate::Drop && !matches!(second, Some(Fate::Deliver(_))) {
            match (self.transport.is_packed(), carried) {
                (false, _) => observer.lost(&packet),
                // QUIC's own, or the control stream's.
                (true, []) => observer.lost(&passing(Kind::Control, &[])),
                (true, carried) => carried.iter().for_each(|bytes| observer.lost(&passing(Kind::Datagram, bytes))),
            }
        }
        for fate in [Some(first), second].into_iter().flatten() {
            if let Fate::Deliver(delay) = fate {
                self.queue.push(now + delay, Event::Packet { client, direction, bytes: bytes.clone() });
            }
        }
    }

    fn link(&mut self, client: usize, direction: Direction) -> &mut VirtualLink {
        match direction {
            Direction::Up => &mut self.clients[client].up,
            Direction::Down => &mut self.clients[client].down,
        }
    }

    /// Takes an arrival into the digest.
    fn note(&mut self, message: &Passing<'_>) {
        self.messages += 1;
        let mut eat = |bytes: &[u8]| {
            for &byte in bytes {
                self.digest = (self.digest ^ u64::from(byte)).wrapping_mul(FNV.1);
            }
        };
        eat(&message.at.micros().to_le_bytes());
        eat(&(message.client as u32).to_le_bytes());
        eat(&[message.direction as u8, message.kind as u8]);
        eat(message.bytes);
    }
}
