//! The client: what it believes about the world, and what it asks.
//!
//! # The idea
//! A client is told only about what it could see. So it must know when it could see something that it is not told of, and
//! that is what walls and *temporal bounding volumes* are for: of each hidden object it holds a ball that contains the object
//! until it expires. Each frame it finds out what hides things from its eye, and from every place that its eye can reach before
//! an answer comes (the *lead*), and asks about the balls that this does not hide any more. ([`eyeline_protocol`] explains it
//! from the start.)
//!
//! # The pieces
//! [`tracking::Tracker`] keeps the beliefs: the volumes in a structure that is walked against an occlusion, their expiries in a
//! queue, what is visible. [`session::Session`] adds the wire: acknowledgements, clocks, what is sent again. Both are pure state
//! machines: no socket, no clock, no thread. What hides things is any [`eyeline_visibility::Occlusion`]; the crate
//! `eyeline-visibility` makes one from triangles. `net` puts QUIC around a session, comes back when the connection is lost, and
//! has the headless client; `app` is the `eyeline-client` command. `examples/watch.rs` is a client in forty lines.
//!
//! # A session without a network
//! ```
//! use eyeline_client::session::{Event, Session, SessionConfig};
//! use eyeline_protocol::{ClientControl, Refusal, ServerControl, codec};
//! use eyeline_visibility::{Aabb, DynamicOctree};
//!
//! let config = SessionConfig::default().with_name("Ada");
//! let mut session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
//!
//! // The first thing that it says is hello.
//! let hello = session.poll_control().expect("it says hello");
//! assert!(matches!(codec::decode_client_control(&hello[4..])?, ClientControl::Hello { name, .. } if name == "Ada"));
//!
//! // What the server says goes in, what an application may want to know comes out.
//! let refused = ServerControl::Refused { refusal: Refusal::Full, reason: "come again later".into() };
//! session.handle_control(&codec::encode_control(&refused)[4..]);
//! assert!(matches!(session.poll_event(), Some(Event::Refused { refusal: Refusal::Full, .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Once it is welcome, each frame is `session.ahead()`, a culling from every eye within that, `session.frame(…)`, and
//! `session.poll_datagram(…)` until there is none.

#[cfg(feature = "net")]
pub mod app;
pub mod clock;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "net")]
mod later;
#[cfg(feature = "net")]
pub mod net;
#[cfg(feature = "net")]
pub mod operate;
pub mod plan;
pub mod session;
#[cfg(feature = "net")]
mod target;
pub mod tracking;
#[cfg(feature = "viewer")]
pub mod viewer;
pub mod world;
