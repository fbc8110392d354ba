//! Who gets in over real QUIC: tokens at a gate, and certificates that are pinned, signed or exchanged. Nothing sleeps: the
//! clocks of tokens are the world's, and files are looked at when a client comes.

use std::future::Future;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use eyeline_client::net::{Arrival, Connection, Endpoint, Fingerprint, LocalClock, NetError, Trust};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_protocol::{Rank, Refusal, Role, WorldInfo, WorldTime};
use eyeline_server::net::{Anonymous, Handle, Identity, Server, TokenGate, WorldClock};
use eyeline_server::policy::Broadcast;
use eyeline_server::spec::WorldSpec;
use eyeline_server::token::files::{Revocations, revoked_path, write_keys};
use eyeline_server::token::{Claims, SecretKey, from_calendar, make_keys};
use eyeline_server::world::{World, WorldConfig};
use eyeline_visibility::{Aabb, DynamicOctree};
use glam::DVec3;
use tempfile::TempDir;

/// What the world's clock shows when a server starts.
fn noon() -> WorldTime {
    from_calendar("2026-01-01T12:00:00Z").unwrap()
}

const HOUR: Duration = Duration::from_secs(3_600);

/// Runs `scenario` beside a server, which has tokens checked beforehand as the program does.
fn beside_server<F: Future<Output = ()>>(
    identity: Identity,
    gate: TokenGate,
    scenario: impl FnOnce(SocketAddr, Handle) -> F,
) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let info = WorldInfo { name: "test".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let (config, spec) = (WorldConfig::default(), WorldSpec::default());
        let mut world = World::new(config, spec, info, DVec3::ZERO, Box::new(Broadcast), noon()).unwrap();
        let checks = gate.checks();
        world.set_gate(Box::new(gate));
        let (any, clock) = ("127.0.0.1:0".parse().unwrap(), WorldClock::starting_at(noon()));
        let server = Server::bind(any, identity, world, Vec::new().into(), clock, None).unwrap();
        let server = server.with_token_checks(checks);
        let (address, handle) = (server.local_addr().unwrap(), server.handle());
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let served = tokio::spawn(server.run(async { drop(stopped.await) }));
        scenario(address, handle).await;
        drop(stop);
        served.await.unwrap();
    });
}

/// For how long a test waits for what must come.
const PATIENCE: Duration = Duration::from_secs(20);

async fn until(is_so: impl Fn() -> bool) {
    let waiting = async {
        while !is_so() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(PATIENCE, waiting).await.unwrap();
}

async fn join(
    trust: impl Into<Trust>,
    address: SocketAddr,
    token: &str,
    role: Role,
) -> Result<(Endpoint, Connection), NetError> {
    let endpoint = Endpoint::new(trust, address)?;
    let config = SessionConfig::default().with_token(token.as_bytes().to_vec()).with_role(role);
    let session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
    let connection = endpoint.connect(address, session, LocalClock::default()).await?;
    Ok((endpoint, connection))
}

fn claims(subject: &str, role: Rank, issued: WorldTime) -> Claims {
    let (audience, id) = ("hall".to_owned(), format!("id-of-{subject}"));
    Claims { audience, subject: subject.into(), id, issued, expires: issued + HOUR, role, avatars: 2 }
}

/// A key in files, and a gate that knows it and nobody without a token.
fn gate(folder: &Path) -> (TokenGate, SecretKey, PathBuf) {
    let (secret, public) = make_keys().unwrap();
    let public = write_keys(&folder.join("tokens.key"), &secret, &public).unwrap();
    let gate = TokenGate::new(std::slice::from_ref(&public), "hall").unwrap();
    (gate.with_anonymous(Anonymous::Never, Rank::Actor, 1), secret, public)
}

#[test]
fn over_quic_a_token_decides_who_comes_in_and_as_what() {
    let folder = TempDir::new().unwrap();
    let (gate, secret, _) = gate(folder.path());
    let identity = Identity::ephemeral().unwrap();
    let pin = Fingerprint(identity.fingerprint());
    beside_server(identity, gate, async |address, handle: Handle| {
        let token = |claims: Claims| secret.issue(&claims).unwrap();
        let refused = async |token: &str, role| match join(pin, address, token, role).await.map(drop) {
            Err(NetError::Refused { refusal: Refusal::Token, reason }) => reason,
            other => panic!("{other:?}"),
        };
        assert!(refused("", Role::Avatar).await.contains("give it with --token"));
        assert!(refused("v4.public.AAAA", Role::Avatar).await.contains("not a token"));
        let two_hours_ago = noon().offset_micros(-7_200_000_000);
        let expired = token(claims("anna", Rank::Actor, two_hours_ago));
        assert!(refused(&expired, Role::Avatar).await.contains("ended at 2026-01-01T11:00:00Z"));
        let elsewhere = Claims { audience: "tower".into(), ..claims("anna", Rank::Actor, noon()) };
        assert!(refused(&token(elsewhere), Role::Avatar).await.contains("not good at this server"));

        let anna = token(claims("anna", Rank::Actor, noon()));
        let (_, connection) = join(pin, address, &anna, Role::Avatar).await.unwrap();
        assert_eq!(connection.session.welcome().map(|welcome| welcome.rank), Some(Rank::Actor));
        connection.close().await;
        assert!(refused(&anna, Role::Actor { avatars: 3 }).await.contains("3 avatars are more than the 2"));
        let viewer = token(claims("bob", Rank::Viewer, noon()));
        assert!(refused(&viewer, Role::Avatar).await.contains("viewer"));
        let (_, connection) = join(pin, address, &viewer, Role::Viewer).await.unwrap();
        connection.close().await;
        assert_eq!(handle.with_world(|world| (world.stats().admitted, world.stats().refused)), (2, 6));
    });
}

#[test]
fn over_quic_what_is_revoked_while_the_server_runs_is_refused() {
    let folder = TempDir::new().unwrap();
    let (gate, secret, public) = gate(folder.path());
    let identity = Identity::ephemeral().unwrap();
    let pin = Fingerprint(identity.fingerprint());
    beside_server(identity, gate, async |address, _| {
        let mut revoked = Revocations::default();
        revoked.revoke_id("id-of-anna");
        revoked.write(&revoked_path(&public)).unwrap();
        let token = |subject| secret.issue(&claims(subject, Rank::Actor, noon())).unwrap();
        let error = join(pin, address, &token("anna"), Role::Avatar).await.map(drop).unwrap_err().to_string();
        assert!(error.contains("revoked"), "{error}");
        join(pin, address, &token("bob"), Role::Avatar).await.unwrap();
    });
}

#[test]
fn over_quic_who_is_inside_with_a_token_that_is_revoked_is_sent_away_and_nobody_else() {
    let folder = TempDir::new().unwrap();
    let (gate, secret, public) = gate(folder.path());
    let identity = Identity::ephemeral().unwrap();
    let pin = Fingerprint(identity.fingerprint());
    beside_server(identity, gate, async |address, handle: Handle| {
        let join = async |subject| {
            let token = secret.issue(&claims(subject, Rank::Actor, noon())).unwrap();
            join(pin, address, &token, Role::Avatar).await.unwrap()
        };
        let ((_annas, mut anna), (_bobs, mut bob)) = (join("anna").await, join("bob").await);
        let mut revoked = Revocations::default();
        revoked.revoke_id("id-of-anna");
        revoked.write(&revoked_path(&public)).unwrap();
        let sent_away = async {
            loop {
                if let Err(error) = anna.arrive().await {
                    return error;
                }
            }
        };
        // The server looks at its lists once a second.
        match tokio::time::timeout(PATIENCE, sent_away).await.unwrap() {
            NetError::Refused { refusal: Refusal::Token, reason } => assert!(reason.contains("revoked"), "{reason}"),
            other => panic!("{other:?}"),
        }
        // It waits until she has it all; then her avatar goes.
        until(|| handle.with_world(|world| world.avatars()) == 1).await;
        assert_eq!(handle.with_world(|world| world.stats().dismissed), 1);
        handle.with_world(|world| world.say_to_all("still here"));
        let heard = async { while !matches!(bob.arrive().await.unwrap(), Arrival::Control) {} };
        tokio::time::timeout(PATIENCE, heard).await.unwrap();
    });
}

#[test]
fn over_quic_who_closes_has_left_and_is_not_waited_for() {
    let gate = TokenGate::new(&[], "hall").unwrap();
    let identity = Identity::ephemeral().unwrap();
    let pin = Fingerprint(identity.fingerprint());
    beside_server(identity, gate, async |address, handle: Handle| {
        let avatars = || handle.with_world(|world| world.avatars());
        let (_annas, anna) = join(pin, address, "", Role::Avatar).await.unwrap();
        let (_bobs, bob) = join(pin, address, "", Role::Avatar).await.unwrap();
        anna.close().await;
        assert_eq!(avatars(), 1, "a goodbye was not heard");
        // Who is merely gone may come back.
        drop(bob);
        until(|| handle.open_connections().1 == 0).await;
        assert_eq!(avatars(), 1);
    });
}

/// An authority, and what it signs: the certificate and its key, in PEM, and the certificate's fingerprint.
struct Authority {
    issuer: rcgen::Issuer<'static, rcgen::KeyPair>,
    pem: String,
}

impl Authority {
    fn new() -> Authority {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params = rcgen::CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let pem = params.self_signed(&key).unwrap().pem();
        Authority { issuer: rcgen::Issuer::new(params, key), pem }
    }

    /// Puts a certificate for `name` and its key there.
    fn sign(&self, name: &str, certificate: &Path, key: &Path) {
        let pair = rcgen::KeyPair::generate().unwrap();
        let params = rcgen::CertificateParams::new(vec![name.to_owned()]).unwrap();
        std::fs::write(certificate, params.signed_by(&pair, &self.issuer).unwrap().pem()).unwrap();
        std::fs::write(key, pair.serialize_pem()).unwrap();
    }
}

#[test]
fn a_signed_certificate_is_believed_for_its_name_and_its_successor_seen_without_a_restart() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (certificate, key, ca, other_ca) = (path("c.pem"), path("k.pem"), path("ca.pem"), path("other.pem"));
    let authority = Authority::new();
    std::fs::write(&ca, &authority.pem).unwrap();
    std::fs::write(&other_ca, Authority::new().pem).unwrap();
    authority.sign("hall.example", &certificate, &key);
    let mut identity = Identity::from_files(&certificate, &key).unwrap();
    let mut reloader = identity.reloader().unwrap();
    let first = Fingerprint(identity.fingerprint());
    let gate = TokenGate::new(&[], "hall").unwrap();
    beside_server(identity, gate, async |address, handle: Handle| {
        let signed = |ca: &Path, name| Trust::signed(ca, name).unwrap();
        let join = async |trust: Trust| join(trust, address, "", Role::Avatar).await;
        let error = async |trust| join(trust).await.map(drop).unwrap_err().to_string();
        let (_endpoint, mut old) = join(signed(&ca, "hall.example")).await.unwrap();
        let said = error(signed(&ca, "tower.example")).await;
        assert!(said.contains("--server-name"), "{said}");
        let said = error(signed(&other_ca, "hall.example")).await;
        assert!(said.contains("--ca"), "{said}");

        // A file that is no good changes nothing.
        std::fs::write(&key, "").unwrap();
        assert!(!reloader.look());
        join(first.into()).await.unwrap();
        authority.sign("hall.example", &certificate, &key);
        assert!(reloader.look());
        let said = error(first.into()).await;
        assert!(said.contains("was pinned"), "{said}");
        join(signed(&ca, "hall.example")).await.unwrap();

        // Who came before goes on.
        handle.with_world(|world| world.say_to_all("still here"));
        let heard = async { while !matches!(old.arrive().await.unwrap(), Arrival::Control) {} };
        tokio::time::timeout(Duration::from_secs(5), heard).await.unwrap();
        old.close().await;
    });
}
