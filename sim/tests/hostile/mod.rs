//! A client that says what it likes, which no session of ours can be.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use eyeline_protocol::codec::{self, ControlReader};
use eyeline_protocol::{ALPN, ServerControl};
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{DigitallySignedStruct, Error, SignatureScheme};

/// A connection, and its control stream once something was said.
pub struct Peer {
    connection: quinn::Connection,
    control: Option<(quinn::SendStream, quinn::RecvStream, ControlReader)>,
    _endpoint: quinn::Endpoint,
}

/// Longest wait for something that must happen: the server gives a silent peer 5 s.
const PATIENCE: Duration = Duration::from_secs(8);

impl Peer {
    /// Connects to whoever is there.
    pub async fn connect(address: SocketAddr) -> Peer {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut tls = rustls::ClientConfig::builder_with_provider(provider.clone())
            .with_protocol_versions(&[&rustls::version::TLS13])
            .unwrap()
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(Trusting(provider)))
            .with_no_client_auth();
        tls.alpn_protocols = vec![ALPN.to_vec()];
        let quic = quinn::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
        let mut config = quinn::ClientConfig::new(Arc::new(quic));
        let mut transport = quinn::TransportConfig::default();
        transport.keep_alive_interval(Some(Duration::from_secs(1)));
        config.transport_config(Arc::new(transport));
        let mut endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
        endpoint.set_default_client_config(config);
        let connection = endpoint.connect(address, "eyeline").unwrap().await.unwrap();
        Peer { connection, control: None, _endpoint: endpoint }
    }

    /// Writes bytes to the control stream.
    pub async fn say(&mut self, bytes: &[u8]) {
        if self.control.is_none() {
            let (send, receive) = self.connection.open_bi().await.unwrap();
            self.control = Some((send, receive, ControlReader::default()));
        }
        self.control.as_mut().unwrap().0.write_all(bytes).await.unwrap();
    }

    /// Sends a datagram, in a packet of its own, before what is said next.
    pub async fn datagram(&self, bytes: &[u8]) {
        self.connection.send_datagram_wait(bytes.to_vec().into()).await.unwrap();
        tokio::time::sleep(Duration::from_millis(30)).await;
    }

    /// The next control message; `None` if the server has closed.
    pub async fn hear(&mut self) -> Option<ServerControl> {
        let (_, receive, reader) = self.control.as_mut()?;
        loop {
            if let Some(message) = reader.next_message().unwrap() {
                return Some(codec::decode_server_control(&message).unwrap());
            }
            let chunk = tokio::time::timeout(PATIENCE, receive.read_chunk(65536, true)).await.expect("silence");
            reader.push(&chunk.ok()??.bytes);
        }
    }

    /// Waits until the server has closed the connection, and fails if it does not.
    pub async fn is_closed(&self) {
        let closed = tokio::time::timeout(PATIENCE, self.connection.closed()).await;
        assert!(matches!(closed, Ok(quinn::ConnectionError::ApplicationClosed(_))), "{closed:?}");
    }
}

/// Trusts every server.
#[derive(Debug)]
struct Trusting(Arc<rustls::crypto::CryptoProvider>);

impl ServerCertVerifier for Trusting {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(Error::General("QUIC has no TLS 1.2".into()))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        rustls::crypto::verify_tls13_signature(message, certificate, signed, &self.0.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}
