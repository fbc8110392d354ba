//! Messages to bytes and back: the only place that knows the format (bincode 2.0.1, standard configuration: little
//! endian, variable-length integers).
//!
//! bincode is finished and unmaintained (RUSTSEC-2025-0141, allowed by number in `deny.toml`): pinned, and kept to this
//! one file so that it can be replaced. Whatever arrives can be wrong, huge or hostile: every decoder has a size
//! limit, reads to the last byte or fails, and allocates no more than a small multiple of its input.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{ClientControl, ClientHeader, ClientRecord, ServerControl, ServerHeader, ServerRecord};

/// Largest control message, in bytes, length prefix apart.
pub const CONTROL_BYTES_MAX: usize = 64 * 1024;

/// Largest datagram that is looked at, in bytes: the most that QUIC can carry over Ethernet, and some.
pub const DATAGRAM_BYTES_MAX: usize = 1500;

/// Bytes that do not say what they should.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The input ends inside a message.
    #[error("message ends early, after {bytes} bytes")]
    Truncated {
        /// Size of the input.
        bytes: usize,
    },
    /// There is something after the message.
    #[error("{bytes} bytes after the end of the message")]
    Extra {
        /// How many.
        bytes: usize,
    },
    /// The input, or what it claims to hold, is larger than allowed.
    #[error("message of {bytes} bytes, or with a part that claims more than its limit of {limit} bytes")]
    TooLarge {
        /// Size of the input.
        bytes: usize,
        /// Most that is allowed.
        limit: usize,
    },
    /// A field is longer than allowed.
    #[error("field {field} is longer than {limit} bytes")]
    Field {
        /// Which.
        field: &'static str,
        /// Most that is allowed.
        limit: usize,
    },
    /// The bytes mean nothing.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// Bytes that the decoder may *claim* (vector and string lengths), so that a small message can't ask for a large
/// allocation. In-memory sizes are at most some ten times the wire's.
const CLAIM_MAX: usize = 16 * CONTROL_BYTES_MAX;

fn decode_one<T: DeserializeOwned>(bytes: &[u8]) -> Result<(T, usize), DecodeError> {
    use bincode::error::DecodeError as Bincode;
    let config = bincode::config::standard().with_limit::<CLAIM_MAX>();
    bincode::serde::decode_from_slice(bytes, config).map_err(|error| match error {
        Bincode::UnexpectedEnd { .. } => DecodeError::Truncated { bytes: bytes.len() },
        Bincode::LimitExceeded => DecodeError::TooLarge { bytes: bytes.len(), limit: CLAIM_MAX },
        other => DecodeError::Malformed(other.to_string()),
    })
}

fn encode_into<T: Serialize>(value: &T, bytes: &mut Vec<u8>) {
    let start = bytes.len();
    let encoded = bincode::serde::encode_to_vec(value, bincode::config::standard());
    match encoded {
        Ok(encoded) => bytes.extend_from_slice(&encoded),
        // Only an id above its maximum can fail, and the world hands out none.
        Err(error) => {
            debug_assert!(false, "unencodable message: {error}");
            bytes.truncate(start);
        }
    }
}

/// A control message with its u32 length (little endian) before it.
pub fn encode_control<T: Serialize>(message: &T) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    encode_into(message, &mut bytes);
    let length = (bytes.len() - 4) as u32;
    bytes[..4].copy_from_slice(&length.to_le_bytes());
    bytes
}

/// A control message from exactly these bytes, without their length prefix.
fn decode_control<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, DecodeError> {
    if bytes.len() > CONTROL_BYTES_MAX {
        return Err(DecodeError::TooLarge { bytes: bytes.len(), limit: CONTROL_BYTES_MAX });
    }
    let (message, used) = decode_one(bytes)?;
    if used < bytes.len() {
        return Err(DecodeError::Extra { bytes: bytes.len() - used });
    }
    Ok(message)
}

/// What a client said on its control stream.
///
/// # Errors
/// If the bytes are not exactly one message within its limits.
pub fn decode_client_control(bytes: &[u8]) -> Result<ClientControl, DecodeError> {
    let message: ClientControl = decode_control(bytes)?;
    message.check()?;
    Ok(message)
}

/// What the server said on a control stream.
///
/// # Errors
/// If the bytes are not exactly one message within its limits.
pub fn decode_server_control(bytes: &[u8]) -> Result<ServerControl, DecodeError> {
    decode_control(bytes)
}

/// Cuts a byte stream into control messages.
#[derive(Default)]
pub struct ControlReader {
    buffer: Vec<u8>,
}

impl ControlReader {
    /// Adds what arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message's bytes, without prefix; `Ok(None)` if there is none yet.
    ///
    /// # Errors
    /// If the announced length is beyond [`CONTROL_BYTES_MAX`]. The stream is useless from then on.
    pub fn next_message(&mut self) -> Result<Option<Vec<u8>>, DecodeError> {
        let Some(prefix) = self.buffer.first_chunk::<4>() else { return Ok(None) };
        let length = u32::from_le_bytes(*prefix) as usize;
        if length > CONTROL_BYTES_MAX {
            return Err(DecodeError::TooLarge { bytes: length, limit: CONTROL_BYTES_MAX });
        }
        if self.buffer.len() < 4 + length {
            return Ok(None);
        }
        let message = self.buffer[4..4 + length].to_vec();
        self.buffer.drain(..4 + length);
        Ok(Some(message))
    }
}

/// Packs records behind a header until a datagram is full.
pub struct DatagramWriter {
    bytes: Vec<u8>,
    limit: usize,
}

impl DatagramWriter {
    /// A datagram of at most `limit` bytes that begins with `header`.
    pub fn new<H: Serialize>(header: &H, limit: usize) -> DatagramWriter {
        let mut bytes = Vec::with_capacity(limit.min(DATAGRAM_BYTES_MAX));
        encode_into(header, &mut bytes);
        DatagramWriter { bytes, limit: limit.min(DATAGRAM_BYTES_MAX) }
    }

    /// Appends `record` if it fits; says whether it did.
    pub fn push<R: Serialize>(&mut self, record: &R) -> bool {
        let before = self.bytes.len();
        encode_into(record, &mut self.bytes);
        if self.bytes.len() > self.limit {
            self.bytes.truncate(before);
            return false;
        }
        true
    }

    /// The datagram.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

fn decode_datagram<H: DeserializeOwned, R: DeserializeOwned>(bytes: &[u8]) -> Result<(H, Vec<R>), DecodeError> {
    if bytes.len() > DATAGRAM_BYTES_MAX {
        return Err(DecodeError::TooLarge { bytes: bytes.len(), limit: DATAGRAM_BYTES_MAX });
    }
    let (header, mut at) = decode_one(bytes)?;
    let mut records = Vec::new();
    while at < bytes.len() {
        let (record, used) = decode_one(&bytes[at..])?;
        records.push(record);
        at += used;
    }
    Ok((header, records))
}

/// A client's datagram.
///
/// # Errors
/// If any byte of it makes no sense; nothing of it is to be believed then.
pub fn decode_client_datagram(bytes: &[u8]) -> Result<(ClientHeader, Vec<ClientRecord>), DecodeError> {
    decode_datagram(bytes)
}

/// The server's datagram.
///
/// # Errors
/// If any byte of it makes no sense; nothing of it is to be believed then.
pub fn decode_server_datagram(bytes: &[u8]) -> Result<(ServerHeader, Vec<ServerRecord>), DecodeError> {
    decode_datagram(bytes)
}
