//! Something that takes long to make, made by another thread, for a shell that has frames to make meanwhile.

use std::sync::mpsc::{Receiver, channel};
use std::thread;

/// A value that is being made.
#[derive(Debug)]
pub(crate) struct Later<T> {
    made: Receiver<T>,
}

impl<T: Send + 'static> Later<T> {
    /// Begins to make it. Where the system has no thread to give it is never there; who waits must be able to do without.
    pub fn start(make: impl FnOnce() -> T + Send + 'static) -> Later<T> {
        let (done, made) = channel();
        let making = thread::Builder::new().name("later".into()).spawn(move || {
            // Nobody waits any more if nobody listens.
            let _ = done.send(make());
        });
        if let Err(error) = making {
            tracing::warn!(%error, "no thread to make something by, which is done without");
        }
        Later { made }
    }

    /// The value, once: when it is there.
    pub fn poll(&mut self) -> Option<T> {
        self.made.try_recv().ok()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn what_is_made_later_is_there_when_it_is_made_and_once() {
        let (go, wait) = channel::<()>();
        let (done, is_done) = channel();
        let mut later = Later::start(move || {
            let _ = wait.recv();
            7
        });
        assert_eq!(later.poll(), None);
        go.send(()).unwrap();
        // The value comes at some time from here on.
        let patient = thread::spawn(move || {
            while later.poll().is_none() {
                thread::yield_now();
            }
            done.send(()).unwrap();
            later.poll()
        });
        is_done.recv().unwrap();
        assert_eq!(patient.join().unwrap(), None);
        // A maker that fails makes nothing, and breaks nobody.
        let mut broken: Later<u8> = Later::start(|| panic!("on purpose"));
        thread::yield_now();
        assert_eq!(broken.poll(), None);
    }
}
