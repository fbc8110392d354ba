//! Several checkers over one run, and the truth for who lies.

use eyeline_protocol::WorldTime;
use eyeline_server::world::World;

use super::heard::Heard;
use super::mutant::Places;
use super::truth::Truth;
use crate::virtual_net::{Framed, Observer, Passing};

/// Shows a run to both checkers, and to a liar.
pub(super) struct Checks<'a> {
    pub truth: &'a mut Truth,
    pub heard: &'a mut Heard,
    pub places: &'a Places,
}

impl Observer for Checks<'_> {
    fn committed(&mut self, world: &World, at: WorldTime) {
        self.places.note(world);
        self.truth.committed(world, at);
        self.heard.committed(world, at);
    }

    fn framed(&mut self, frame: &Framed<'_>) {
        self.truth.framed(frame);
        self.heard.framed(frame);
    }

    fn sent(&mut self, message: &Passing<'_>) {
        self.heard.sent(message);
    }

    fn arrives(&mut self, message: &Passing<'_>) {
        self.truth.arrives(message);
        self.heard.arrives(message);
    }

    fn lost(&mut self, message: &Passing<'_>) {
        self.truth.lost(message);
        self.heard.lost(message);
    }
}
