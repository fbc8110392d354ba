//! The shared world: who is where, and who may be told.
//!
//! # The idea
//! Everybody walks through the same building, and nobody is told what walls hide from them. For each object that is hidden
//! from it a client holds a *temporal bounding volume*: a ball that contains the object until it expires, since nothing is
//! faster than its class. As long as walls hide the ball nobody says anything; once it comes into view the client asks, and is
//! told a fresh ball, or the object's state from now on. So a server sends what is visible, and next to nothing for what is
//! not. ([`eyeline_protocol`] explains it from the start; ARCHITECTURE.md has what must stay true.)
//!
//! # The pieces
//! [`world::World`] is a pure state machine: who is where, what each client was told, what is due. It has no socket and no
//! clock, so it runs over real QUIC and in virtual time alike. A [`policy::Policy`] decides whom each client is told about
//! (`visible` leaves that to the client, who asks); a [`gate::Gate`] decides who comes in; an [`audit::Audit`] looks for itself
//! whether a client may see what it asks for. `net` puts sockets, certificates, limits and a clock around a world; `app` is the
//! `eyeline-server` command. `examples/serve.rs` is a server in thirty lines.
//!
//! # A world without a network
//! ```
//! use eyeline_protocol::{ClientControl, Interest, Role, ServerControl, VERSION, WorldInfo, WorldTime, codec};
//! use eyeline_server::policy::Visible;
//! use eyeline_server::spec::WorldSpec;
//! use eyeline_server::world::{Transmit, World, WorldConfig};
//! use glam::DVec3;
//!
//! // What moves is said by a `world.toml`, here an empty one; where walls are only clients need to know.
//! let info = WorldInfo { name: "nowhere".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
//! let now = WorldTime::ZERO;
//! let policy = Box::new(Visible);
//! let mut world = World::new(WorldConfig::default(), WorldSpec::default(), info, DVec3::ZERO, policy, now)?;
//!
//! // A connection, and the first message on its control stream.
//! let client = world.connect(now);
//! let hello = ClientControl::Hello {
//!     version: VERSION,
//!     token: Vec::new(),
//!     resolution: (320, 240),
//!     interest: Interest::Around,
//!     role: Role::Avatar,
//!     name: "Ada".into(),
//!     resume: None,
//! };
//! world.handle_control(client, &codec::encode_control(&hello)[4..], now);
//!
//! // What is to be sent comes out until there is nothing more: first of all, the welcome.
//! let Some((to, Transmit::Control(bytes))) = world.poll_transmit(now) else { panic!("not welcome") };
//! assert_eq!(to, client);
//! let ServerControl::Welcome(welcome) = codec::decode_server_control(&bytes[4..])? else { panic!("not welcome") };
//! let (avatar, place, _) = welcome.avatars[0];
//!
//! // Time passes in ticks. What clients want is committed then, as far as nobody is faster than they may be.
//! world.tick(world.poll_timeout());
//! assert_eq!(world.objects()[avatar.index()].position, place);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(all(feature = "net", feature = "audit"))]
pub mod app;
pub mod audit;
#[cfg(all(feature = "net", feature = "audit"))]
pub mod config;
pub mod gate;
#[cfg(any(feature = "net", feature = "audit"))]
mod hash;
pub mod histogram;
#[cfg(feature = "audit")]
pub mod model;
#[cfg(feature = "net")]
pub mod net;
pub mod path;
pub mod plan;
pub mod policy;
pub mod spec;
pub mod spring;
#[cfg(feature = "net")]
pub mod stop;
#[cfg(feature = "net")]
pub mod token;
pub mod world;
