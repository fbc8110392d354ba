//! Is a token signed by one of our keys? Checked before the world hears of it: a signature takes about as long as a tick of
//! many clients, and a stranger may ask for [`super::KEYS_MAX`] checks of it.
//!
//! The connection's task has a token checked on another thread and leaves the outcome here; the gate, which the world asks
//! while everything else waits, takes it. Where nobody has checked beforehand (an embedding without our shell), or a key has
//! changed since, the gate checks itself.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use eyeline_protocol::WorldTime;

use crate::token::{Claims, PublicKey, TokenError, verify};

/// Most outcomes that wait to be taken. Each is taken at once, so there are more only of connections that ended in between.
const OUTCOMES_MAX: usize = 64;

type Outcome = Result<(Claims, usize), TokenError>;

#[derive(Debug)]
struct Inner {
    keys: Arc<[PublicKey]>,
    /// Counts changes of the keys.
    generation: u64,
    outcomes: VecDeque<(Vec<u8>, Outcome)>,
}

/// Checks of tokens for a gate. Cheap to clone.
#[derive(Clone, Debug)]
pub struct TokenChecks {
    audience: Arc<str>,
    inner: Arc<Mutex<Inner>>,
}

impl TokenChecks {
    pub(super) fn new(keys: Arc<[PublicKey]>, audience: &str) -> TokenChecks {
        let inner = Inner { keys, generation: 0, outcomes: VecDeque::new() };
        TokenChecks { audience: audience.into(), inner: Arc::new(Mutex::new(inner)) }
    }

    fn with<T>(&self, f: impl FnOnce(&mut Inner) -> T) -> T {
        f(&mut self.inner.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Other keys from now on; what was found with the old ones is forgotten.
    pub(super) fn use_keys(&self, keys: Arc<[PublicKey]>) {
        self.with(|inner| {
            (inner.keys, inner.generation) = (keys, inner.generation + 1);
            inner.outcomes.clear();
        });
    }

    /// Checks a token, and keeps what came of it for the gate. May take a millisecond; nobody else waits for it.
    pub fn check(&self, token: &[u8], now: WorldTime) {
        let (keys, generation) = self.with(|inner| (inner.keys.clone(), inner.generation));
        let outcome = verify(token, keys.iter(), &self.audience, now);
        self.with(|inner| {
            if inner.generation == generation {
                inner.outcomes.push_back((token.to_vec(), outcome));
                // The oldest go: nobody came for them.
                while inner.outcomes.len() > OUTCOMES_MAX {
                    inner.outcomes.pop_front();
                }
            }
        });
    }

    /// What came of checking a token: beforehand, or now.
    pub(super) fn take(&self, token: &[u8], now: WorldTime) -> Outcome {
        let (keys, known) = self.with(|inner| {
            let found = inner.outcomes.iter().position(|(checked, _)| checked == token);
            (inner.keys.clone(), found.and_then(|index| inner.outcomes.remove(index)))
        });
        match known {
            Some((_, outcome)) => outcome,
            None => verify(token, keys.iter(), &self.audience, now),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::token::{from_calendar, make_keys};

    #[test]
    fn what_was_checked_beforehand_is_taken_once_and_not_after_a_change_of_keys() {
        let now = from_calendar("2026-01-01T12:00:00Z").unwrap();
        let (secret, public) = make_keys().unwrap();
        let checks = TokenChecks::new([public].into(), "hall");
        let claims = Claims {
            audience: "hall".into(),
            subject: "anna".into(),
            id: "0123456789abcdef".into(),
            issued: now,
            expires: now + std::time::Duration::from_secs(60),
            role: eyeline_protocol::Rank::Actor,
            avatars: 1,
        };
        let token = secret.issue(&claims).unwrap().into_bytes();
        let waiting = || checks.with(|inner| inner.outcomes.len());
        checks.check(&token, now);
        checks.check(b"another", now);
        assert_eq!(waiting(), 2);
        assert_eq!(checks.take(&token, now), Ok((claims.clone(), 0)));
        assert_eq!(waiting(), 1);
        // Nobody has checked it again: that is done now.
        assert_eq!(checks.take(&token, now), Ok((claims, 0)));
        checks.check(&token, now);
        checks.use_keys([make_keys().unwrap().1].into());
        assert_eq!(waiting(), 0);
        assert_eq!(checks.take(&token, now), Err(TokenError::Signature));
        for number in 0..OUTCOMES_MAX + 5 {
            checks.check(format!("{number}").as_bytes(), now);
        }
        assert_eq!(waiting(), OUTCOMES_MAX);
    }
}
