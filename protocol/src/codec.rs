//! Messages to bytes and back: the only place that knows the format (bincode 2.0.1, standard configuration: little
//! endian, variable-length integers).
//!
//! bincode is finished and unmaintained (RUSTSEC-2025-0141, allowed by number in `deny.toml`): pinned, and kept to this
//! one file so that it can be replaced. Whatever arrives can be wrong, huge or hostile: every decoder has a size
//! limit, reads to the last byte or fails, and allocates no more than a small multiple of its input (what is claimed
//! but not there costs nothing). What it then hands out has passed [`Message::check`].

use crate::{
    ClientControl, ClientHeader, ClientRecord, Interest, Message, Role, ServerControl, ServerHeader, ServerRecord,
    VERSION,
};

/// Largest control message of either end, in bytes, length prefix apart: holds the greatest legal welcome and roster.
pub const CONTROL_BYTES_MAX: usize = 256 * 1024;

/// Largest control message of a client, in bytes, length prefix apart: all that a server ever buffers for a stranger.
pub const CLIENT_CONTROL_BYTES_MAX: usize = 2 * 1024;

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
    #[error("field '{field}' is longer than {limit}")]
    Field {
        /// Which.
        field: &'static str,
        /// Most bytes or elements that are allowed.
        limit: usize,
    },
    /// A field's number is out of range, or none.
    #[error("field '{field}' is out of range")]
    Value {
        /// Which.
        field: &'static str,
    },
    /// The bytes mean nothing.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// Bytes that bincode may *claim*: a second fence. It counts eight for an integer that took one, hence the factor; it
/// does not count what serde reserves for a list, which is why lists are read by [`crate::untrusted`].
const CLAIM_MAX: usize = 16 * CONTROL_BYTES_MAX;

fn decode_one<M: Message>(bytes: &[u8]) -> Result<(M, usize), DecodeError> {
    let (message, used): (M, usize) = decode_unchecked(bytes)?;
    message.check()?;
    Ok((message, used))
}

fn decode_unchecked<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<(T, usize), DecodeError> {
    use bincode::error::DecodeError as Bincode;
    let config = bincode::config::standard().with_limit::<CLAIM_MAX>();
    bincode::serde::decode_from_slice(bytes, config).map_err(|error| match error {
        Bincode::UnexpectedEnd { .. } => DecodeError::Truncated { bytes: bytes.len() },
        Bincode::LimitExceeded => DecodeError::TooLarge { bytes: bytes.len(), limit: CLAIM_MAX },
        // A type's own words; bincode shows the rest as they are called in its source.
        Bincode::OtherString(why) => DecodeError::Malformed(why),
        other => DecodeError::Malformed(other.to_string()),
    })
}

struct Append<'a>(&'a mut Vec<u8>);

impl bincode::enc::write::Writer for Append<'_> {
    // Inlined into what calls it with an array: of a place's twelve bytes each is one store, and no call.
    #[inline(always)]
    fn write(&mut self, bytes: &[u8]) -> Result<(), bincode::error::EncodeError> {
        // Nearly all that is written is a byte or two: copies of a known size are no calls.
        match *bytes {
            [byte] => self.0.push(byte),
            [a, b] => self.0.extend_from_slice(&[a, b]),
            [a, b, c, d] => self.0.extend_from_slice(&[a, b, c, d]),
            _ => self.0.extend_from_slice(bytes),
        }
        Ok(())
    }
}

fn encode_into<M: Message>(message: &M, bytes: &mut Vec<u8>) {
    debug_assert!(message.check().is_ok(), "what a peer would refuse: {:?}", message.check());
    let start = bytes.len();
    if let Err(error) = bincode::serde::encode_into_writer(message, Append(bytes), bincode::config::standard()) {
        // Only an id above its maximum can fail, and the world hands out none.
        debug_assert!(false, "unencodable message: {error}");
        bytes.truncate(start);
    }
}

/// A control message with its u32 length (little endian) before it.
pub fn encode_control<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    encode_into(message, &mut bytes);
    let length = bytes.len() - 4;
    debug_assert!(length <= CONTROL_BYTES_MAX, "a message of {length} bytes, which a peer would refuse");
    bytes[..4].copy_from_slice(&(length as u32).to_le_bytes());
    bytes
}

/// A control message from exactly these bytes, without their length prefix.
fn decode_control<M: Message>(bytes: &[u8], limit: usize) -> Result<M, DecodeError> {
    if bytes.len() > limit {
        return Err(DecodeError::TooLarge { bytes: bytes.len(), limit });
    }
    let (message, used) = decode_one(bytes)?;
    if used < bytes.len() {
        return Err(DecodeError::Extra { bytes: bytes.len() - used });
    }
    Ok(message)
}

/// What a client said on its control stream.
///
/// Of a hello of another [`VERSION`] only the version is read, since whatever follows it may have another shape: so the
/// server can say which version it misses instead of complaining about bytes.
///
/// # Errors
/// If the bytes are not exactly one message within its limits.
pub fn decode_client_control(bytes: &[u8]) -> Result<ClientControl, DecodeError> {
    // The number of hello, which with the version after it never changes. Numbers can be spelt longer than need be.
    if bytes.len() <= CLIENT_CONTROL_BYTES_MAX
        && let Ok(((0, version), _)) = decode_unchecked::<(u32, u16)>(bytes)
        && version != VERSION
    {
        return Ok(ClientControl::Hello {
            version,
            token: Vec::new(),
            resolution: (0, 0),
            interest: Interest::Around,
            role: Role::Avatar,
            name: String::new(),
            resume: None,
        });
    }
    decode_control(bytes, CLIENT_CONTROL_BYTES_MAX)
}

/// What the server said on a control stream.
///
/// # Errors
/// If the bytes are not exactly one message within its limits.
pub fn decode_server_control(bytes: &[u8]) -> Result<ServerControl, DecodeError> {
    decode_control(bytes, CONTROL_BYTES_MAX)
}

/// Cuts a byte stream into control messages.
///
/// After each [`push`](ControlReader::push) take [`next_message`](ControlReader::next_message) until there is none;
/// then it never holds more than one message and what was pushed last.
pub struct ControlReader {
    buffer: Vec<u8>,
    /// Bytes of `buffer` that were handed out already.
    taken: usize,
    limit: usize,
}

impl Default for ControlReader {
    /// Reads what a server says: messages of up to [`CONTROL_BYTES_MAX`].
    fn default() -> ControlReader {
        ControlReader { buffer: Vec::new(), taken: 0, limit: CONTROL_BYTES_MAX }
    }
}

impl ControlReader {
    /// Reads what a client says: messages of up to [`CLIENT_CONTROL_BYTES_MAX`].
    pub fn of_client() -> ControlReader {
        ControlReader { limit: CLIENT_CONTROL_BYTES_MAX, ..ControlReader::default() }
    }

    /// Adds what arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        // Moved up once a push, not once a message: a thousand tiny messages in one push would cost a thousand moves.
        self.buffer.drain(..self.taken);
        self.taken = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message's bytes, without prefix; `Ok(None)` if there is none yet.
    ///
    /// # Errors
    /// If the announced length is beyond the limit. The stream is useless from then on, and says so again.
    pub fn next_message(&mut self) -> Result<Option<Vec<u8>>, DecodeError> {
        let rest = &self.buffer[self.taken..];
        let Some((prefix, rest)) = rest.split_first_chunk::<4>() else { return Ok(None) };
        let length = u32::from_le_bytes(*prefix) as usize;
        if length > self.limit {
            return Err(DecodeError::TooLarge { bytes: length, limit: self.limit });
        }
        let Some(message) = rest.get(..length) else { return Ok(None) };
        let message = message.to_vec();
        self.taken += 4 + length;
        Ok(Some(message))
    }
}

/// A record's or header's bytes as a datagram carries them, at the beginning of `bytes`, and how many: for what many are told alike. None if they do
/// not fit.
pub fn encode_record<R: Message>(record: &R, bytes: &mut [u8]) -> usize {
    debug_assert!(record.check().is_ok(), "what a peer would refuse: {:?}", record.check());
    let encoded = bincode::serde::encode_into_slice(record, bytes, bincode::config::standard());
    debug_assert!(encoded.is_ok(), "unencodable record: {:?}", encoded.err());
    encoded.unwrap_or(0)
}

/// Packs records behind a header until a datagram is full.
pub struct DatagramWriter {
    bytes: Vec<u8>,
    limit: usize,
    /// Bytes in front that are left free for the header.
    room: usize,
}

impl DatagramWriter {
    /// A datagram of at most `limit` bytes that begins with `header`, which goes in however small the limit is.
    pub fn new<H: Message>(header: &H, limit: usize) -> DatagramWriter {
        let mut bytes = Vec::with_capacity(limit.min(DATAGRAM_BYTES_MAX));
        encode_into(header, &mut bytes);
        DatagramWriter { bytes, limit: limit.min(DATAGRAM_BYTES_MAX), room: 0 }
    }

    /// A datagram of at most `limit` bytes whose header is not known yet: that is said by [`DatagramWriter::finish_with`],
    /// in at most `room` bytes, which go in however small the limit is. What `bytes` held is lost; its memory is used, and had
    /// again when the datagram is finished.
    pub fn before_header(room: usize, limit: usize, mut bytes: Vec<u8>) -> DatagramWriter {
        bytes.clear();
        bytes.resize(room, 0);
        DatagramWriter { bytes, limit: limit.min(DATAGRAM_BYTES_MAX), room }
    }

    /// Appends `record` if it fits; says whether it did.
    pub fn push<R: Message>(&mut self, record: &R) -> bool {
        let before = self.bytes.len();
        encode_into(record, &mut self.bytes);
        if self.bytes.len() > self.limit {
            self.bytes.truncate(before);
            return false;
        }
        true
    }

    /// Appends a record's bytes ([`encode_record`]) if they fit; says whether they did.
    pub fn push_encoded(&mut self, record: &[u8]) -> bool {
        let fits = self.bytes.len() + record.len() <= self.limit;
        if fits {
            self.bytes.extend_from_slice(record);
        }
        fits
    }

    /// Size so far, in bytes, with all the room for the header.
    pub fn bytes(&self) -> usize {
        self.bytes.len()
    }

    /// The datagram, of a writer that began with its header.
    pub fn finish(self) -> Vec<u8> {
        debug_assert_eq!(self.room, 0, "the header is missing");
        self.bytes
    }

    /// Gives the datagram up: the memory that its records were gathered in.
    pub fn give_up(self) -> Vec<u8> {
        self.bytes
    }

    /// The datagram, of a writer that began before its header was known, and the memory that its records were gathered in.
    pub fn finish_with<H: Message>(self, header: &H) -> (Vec<u8>, Vec<u8>) {
        let DatagramWriter { mut bytes, room, .. } = self;
        // Up against the records, so that one copy of just the right size is the datagram: QUIC keeps that as it is.
        let length = encode_record(header, &mut bytes[..room]);
        bytes.copy_within(..length, room - length);
        (bytes[room - length..].to_vec(), bytes)
    }
}

fn decode_datagram<H: Message, R: Message>(bytes: &[u8]) -> Result<(H, Vec<R>), DecodeError> {
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
