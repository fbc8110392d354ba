//! `eyeline-server token …`: what its owner does with keys and tokens. Text in, text out; the command prints it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use clap::{ArgGroup, Args, Subcommand};
use eyeline_protocol::{Rank, WorldTime};

use super::files::{Revocations, public_path, read_public, read_secret, revoked_path, write_keys};
use super::{Claims, TOKEN_PREFIX, VALID_MAX, calendar, make_keys, peek, verify};
use crate::config::Flags;
use crate::config::options::{ServerOptions, role, span};

/// What can be done with tokens.
#[derive(Subcommand)]
pub enum TokenVerb {
    /// Makes a pair of Ed25519 keys: the private one, with which tokens are issued, and beside it NAME.pub for servers
    Key(Key),
    /// Issues a token and prints it
    Issue(Issue),
    /// Revokes a token, or all that a subject has; a running server notices within a second
    Revoke(Revoke),
    /// Says what is in a token, and whether it is good
    Show(Show),
}

/// Options of `token key`.
#[derive(Args)]
pub struct Key {
    /// File of the private key; never written over
    #[arg(value_name = "FILE", default_value = "eyeline-identity/tokens.key")]
    file: PathBuf,
}

/// Options of `token issue`.
#[derive(Args)]
pub struct Issue {
    /// What its bearer may be: a viewer looks, an actor has avatars, an operator keeps order too
    #[arg(long, value_parser = role(&Rank::ALL))]
    role: Rank,

    /// Whom it is for: a name by which to revoke it, which operators see
    #[arg(long, value_name = "NAME")]
    subject: String,

    /// For how long it is good, at most 30d. Who needs it for longer is better given another then
    #[arg(long, value_name = "TIME", default_value = "8h", value_parser = span(VALID_MAX))]
    valid: Duration,

    /// Most avatars of one connection
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    avatars: u16,

    /// The private key that signs it
    #[arg(long, value_name = "FILE")]
    key: PathBuf,

    #[command(flatten)]
    server: Server,
}

/// For which server.
#[derive(Args)]
pub struct Server {
    /// The server's name, its --token-audience [default: as in its settings, else eyeline]
    #[arg(long, value_name = "NAME")]
    audience: Option<String>,

    /// The server's settings [default: eyeline-server.toml in the current folder, if it is there]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// Options of `token revoke`.
#[derive(Args)]
#[command(group(ArgGroup::new("what").required(true)))]
pub struct Revoke {
    /// The key that signed it, either half: the list is NAME.revoked beside it
    #[arg(long, value_name = "FILE")]
    key: PathBuf,

    /// A token's own name, as `token issue` and `token show` say it
    #[arg(long, group = "what")]
    id: Option<String>,

    /// All that was issued to this subject until now; what is issued later is good again
    #[arg(long, value_name = "NAME", group = "what")]
    subject: Option<String>,

    /// The token itself, or a file that it is in
    #[arg(long, value_name = "TOKEN|FILE", group = "what")]
    token: Option<String>,
}

/// Options of `token show`.
#[derive(Args)]
pub struct Show {
    /// The token, or a file that it is in
    #[arg(value_name = "TOKEN|FILE")]
    token: String,

    /// Public keys that may have signed it [default: those of the server's settings]
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    key: Vec<PathBuf>,

    #[command(flatten)]
    server: Server,
}

/// What a verb has to say: the result, and what is only for people.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// For standard output.
    pub out: String,
    /// For standard error.
    pub aside: String,
}

/// Does what was asked, at the calendar's time `now`.
///
/// # Errors
/// Names what is wrong, its place and the remedy.
pub fn run(verb: &TokenVerb, now: WorldTime) -> anyhow::Result<Said> {
    match verb {
        TokenVerb::Key(options) => key(&options.file),
        TokenVerb::Issue(options) => issue(options, now),
        TokenVerb::Revoke(options) => revoke(options, now),
        TokenVerb::Show(options) => show(options, now),
    }
}

fn key(path: &Path) -> anyhow::Result<Said> {
    let (secret, public) = make_keys()?;
    let public_path = write_keys(path, &secret, &public)?;
    let out = format!(
        "private  {} (keep it to yourself: who has it can issue tokens)\npublic   {} (name it to the server with \
         --token-keys, or gate.keys = [\"…\"])\n",
        path.display(),
        public_path.display()
    );
    Ok(Said { out, aside: String::new() })
}

fn issue(options: &Issue, now: WorldTime) -> anyhow::Result<Said> {
    let secret = read_secret(&options.key)?;
    let issued = WorldTime::from_micros(now.micros().div_euclid(1_000_000) * 1_000_000);
    let claims = Claims {
        audience: audience(&options.server)?,
        subject: options.subject.clone(),
        id: format!("{:016x}", crate::app::random()?),
        issued,
        expires: issued + options.valid,
        role: options.role,
        avatars: options.avatars,
    };
    let out = secret.issue(&claims)? + "\n";
    Ok(Said { out, aside: format!("id {}, good until {}\n", claims.id, calendar(claims.expires)) })
}

fn revoke(options: &Revoke, now: WorldTime) -> anyhow::Result<Said> {
    // A list beside a file that is no key would be one that no server looks at.
    let is_secret = options.key.extension().is_none_or(|extension| extension != "pub");
    if is_secret {
        read_secret(&options.key)?;
    } else {
        read_public(&options.key)?;
    }
    let path = revoked_path(&options.key);
    let mut revoked = Revocations::read(&path)?;
    let what = match (&options.id, &options.subject, &options.token) {
        (Some(id), ..) => {
            anyhow::ensure!(
                id.len() == 16 && id.chars().all(|c| c.is_ascii_hexdigit() && !c.is_ascii_uppercase()),
                "--id '{id}' is not a token's name: 16 digits of 0-9 and a-f, as `eyeline-server token show` says it"
            );
            revoked.revoke_id(id);
            format!("token {id}")
        }
        (_, Some(subject), _) => {
            revoked.revoke_subject(subject, now);
            format!("what '{subject}' was issued until {}", calendar(now))
        }
        (.., Some(token)) => {
            let claims = peek(&read_token(token)?)?;
            revoked.revoke_id(&claims.id);
            format!("token {} of '{}'", claims.id, claims.subject)
        }
        _ => anyhow::bail!("which? give --id, --subject or --token"),
    };
    revoked.write(&path)?;
    let out = format!("revoked  {what}, in {} ({} entries)\n", path.display(), revoked.len());
    Ok(Said { out, aside: String::new() })
}

fn show(options: &Show, now: WorldTime) -> anyhow::Result<Said> {
    let token = read_token(&options.token)?;
    let claims = peek(&token)?;
    let paths = if options.key.is_empty() { settings(&options.server)?.serve.gate.keys } else { options.key.clone() };
    let verdict = if paths.is_empty() {
        "unknown: name the server's public key with --key to have the signature checked".to_owned()
    } else {
        // A private key's public half is beside it.
        let paths: Vec<PathBuf> = paths.iter().map(|path| public_path(path)).collect();
        let keys = paths.iter().map(|path| read_public(path)).collect::<Result<Vec<_>, _>>()?;
        match verify(&token, &keys, &audience(&options.server)?, now) {
            Err(error) => format!("no: {error}"),
            Ok((claims, index)) if Revocations::read(&revoked_path(&paths[index]))?.covers(&claims) => {
                format!("no: it is revoked, in {}", revoked_path(&paths[index]).display())
            }
            Ok((_, index)) => format!("yes, signed with {}", paths[index].display()),
        }
    };
    let out = format!(
        "id       {}\nsubject  {}\nrole     {}, at most {} avatars\nserver   {}\nissued   {}\nends     {}\ngood     {verdict}\n",
        claims.id,
        claims.subject.escape_debug(),
        claims.role,
        claims.avatars,
        claims.audience.escape_debug(),
        calendar(claims.issued),
        calendar(claims.expires),
    );
    Ok(Said { out, aside: String::new() })
}

fn settings(server: &Server) -> anyhow::Result<ServerOptions> {
    let flags = Flags::<ServerOptions>::none();
    let flags = match &server.config {
        Some(file) => flags.with_file(file),
        None => flags,
    };
    Ok(flags.load(&[])?.options)
}

fn audience(server: &Server) -> anyhow::Result<String> {
    match &server.audience {
        Some(audience) => {
            Ok(crate::config::options::audience(audience).map_err(|wrong| anyhow::anyhow!("--audience: {wrong}"))?)
        }
        None => Ok(settings(server)?.serve.gate.audience),
    }
}

/// A token as it is given: itself, or the file that it is in.
fn read_token(given: &str) -> anyhow::Result<Vec<u8>> {
    if given.trim().starts_with(TOKEN_PREFIX) {
        return Ok(given.trim().into());
    }
    let text = super::files::read_text(Path::new(given), 64 << 10).with_context(|| {
        format!("'{}' is no token, which begins with {TOKEN_PREFIX}, nor a file with one", given.escape_debug())
    })?;
    Ok(text.trim().into())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(subcommand)]
        verb: TokenVerb,
    }

    fn said(args: &[&str], now: WorldTime) -> anyhow::Result<Said> {
        let command = Command::try_parse_from(std::iter::once("token").chain(args.iter().copied()))?;
        run(&command.verb, now)
    }

    #[test]
    fn a_token_is_issued_shown_revoked_and_shown_as_revoked() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let (key, public, now) = (path("t.key"), path("t.pub"), WorldTime::from_micros(1_767_225_600_400_000));
        let at = |args: &[&str]| said(args, now).map_err(|error| crate::app::one_line(&error));
        assert!(at(&["key", &key]).unwrap().out.contains("t.pub"));

        let issue =
            ["issue", "--role", "operator", "--subject", "anna", "--valid", "2h", "--avatars", "3", "--key", &key];
        let issued = at(&[&issue[..], &["--audience", "hall"]].concat()).unwrap();
        assert!(issued.aside.ends_with("good until 2026-01-01T02:00:00Z\n"), "{}", issued.aside);
        let token = issued.out.trim();
        std::fs::write(path("token"), &issued.out).unwrap();

        let show =
            |audience: &str| at(&["show", &path("token"), "--key", &public, "--audience", audience]).unwrap().out;
        assert!(show("hall").contains("role     operator, at most 3 avatars"), "{}", show("hall"));
        assert!(show("hall").contains("good     yes"), "{}", show("hall"));
        assert!(show("tower").contains("good     no: the token is for the server 'hall'"), "{}", show("tower"));
        let unchecked = at(&["show", token, "--config", &path("none")]).unwrap_err();
        assert!(unchecked.contains("none: No such file"), "{unchecked}");

        let revoked = at(&["revoke", "--key", &key, "--token", token]).unwrap();
        assert!(revoked.out.contains("'anna'") && revoked.out.contains("t.revoked"), "{}", revoked.out);
        assert!(show("hall").contains("good     no: it is revoked"), "{}", show("hall"));
        let again = at(&["revoke", "--key", &public, "--subject", "bob"]).unwrap();
        assert!(again.out.contains("2 entries"), "{}", again.out);
    }
}
