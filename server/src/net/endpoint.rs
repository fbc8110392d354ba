//! How the server speaks QUIC and TLS, and from which socket.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::ALPN;
use quinn::crypto::rustls::QuicServerConfig;

use super::flush::DATAGRAM_BUFFER;
use super::{Identity, ServeError};

/// How this server speaks QUIC and TLS, wherever its packets go.
///
/// # Errors
/// If the identity is of no use.
pub fn quic_config(identity: Identity) -> Result<quinn::ServerConfig, ServeError> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])?
        .with_no_client_auth()
        .with_cert_resolver(identity.shown());
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let mut config = quinn::ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls)?));
    config.transport_config(Arc::new(transport()));
    // First packets wait here only until they are looked at, which is at once, and for their turn. By default each may have
    // 10 MB of what follows it kept.
    config.max_incoming(4_096).incoming_buffer_size(16 * 1024).incoming_buffer_size_total(8 << 20);
    Ok(config)
}

/// After how many packets at the latest a client acknowledges them, unless it has something to send.
const ACKS_AFTER: u32 = 9;

/// Few streams and small windows: a connection's memory is what limits a server of thousands (FACTS: stream limits of
/// 8 instead of 100 save a fifth, MTU discovery off halves the handshake). The datagram buffer holds two ticks of a busy
/// client, so that it can't hide seconds of stale poses.
fn transport() -> quinn::TransportConfig {
    let mut transport = quinn::TransportConfig::default();
    // Packets are what a server of thousands pays for. By default every second one is acknowledged by another at once, though a
    // client's next frame would do.
    let mut acks = quinn::AckFrequencyConfig::default();
    acks.ack_eliciting_threshold(ACKS_AFTER.into());
    transport
        .max_concurrent_bidi_streams(1u32.into())
        .max_concurrent_uni_streams(0u32.into())
        .max_idle_timeout(Some(quinn::IdleTimeout::from(quinn::VarInt::from_u32(10_000))))
        .keep_alive_interval(Some(Duration::from_secs(4)))
        .datagram_receive_buffer_size(Some(64 * 1024))
        .datagram_send_buffer_size(DATAGRAM_BUFFER)
        .stream_receive_window(quinn::VarInt::from_u32(128 * 1024))
        .receive_window(quinn::VarInt::from_u32(256 * 1024))
        .send_window(1 << 20)
        .ack_frequency_config(Some(acks))
        // With it a connection keeps ten packets' room for ever, for the sake of the world that it was sent once.
        .enable_segmentation_offload(false)
        .mtu_discovery_config(None);
    transport
}

/// A socket with buffers for a tick's burst: the system's default drops them (FACTS). Does not block.
///
/// # Errors
/// If the address can't be had.
pub fn socket(address: SocketAddr) -> std::io::Result<std::net::UdpSocket> {
    let socket = socket2::Socket::new(
        socket2::Domain::for_address(address),
        socket2::Type::DGRAM,
        Some(socket2::Protocol::UDP),
    )?;
    // As much as the system gives; less is no error.
    let _ = socket.set_recv_buffer_size(4 << 20);
    let _ = socket.set_send_buffer_size(4 << 20);
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    Ok(socket.into())
}
