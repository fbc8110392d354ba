//! `eyeline-client operate`: what somebody who keeps order does with a server that runs.

use std::time::Duration;

use anyhow::Context;
use clap::{Args, Subcommand};
use eyeline_protocol::{ClientEntry, ClientId, Command, Role};
use eyeline_visibility::{Aabb, DynamicOctree};

use crate::app::{Target, print};
use crate::net::LocalClock;
use crate::session::{Event, Session, SessionConfig};

/// Options of `operate`.
#[derive(Args, Clone, Debug)]
pub struct Operate {
    #[command(flatten)]
    target: Target,

    #[command(subcommand)]
    order: Order,
}

/// What to do.
#[derive(Subcommand, Clone, Debug)]
enum Order {
    /// Who is here?
    List,
    /// Send a client away; it may come again
    Kick {
        /// Its number, as `list` shows it
        client: u32,
        /// Why, for them
        #[arg(long, default_value = "an operator sent you away")]
        reason: String,
    },
    /// Send a client away for good: not with its token, or if it has none, not from its address
    Ban {
        /// Its number, as `list` shows it
        client: u32,
        /// For how long, seconds [default: until the server ends]
        #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u32).range(1..))]
        seconds: Option<u32>,
        /// Why, for them
        #[arg(long, default_value = "an operator banned you")]
        reason: String,
    },
    /// Tell everybody something
    Say {
        /// What
        text: String,
    },
}

/// Examples for `--help`.
pub const EXAMPLES: &str = "Examples:
  eyeline-client operate --server-file ready.txt --token chief.token list
  eyeline-client operate --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --token chief.token kick 7 --reason \"too loud\"
  eyeline-client operate --server-file ready.txt --token chief.token ban 7 --seconds 3600";

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(5);

impl Order {
    fn command(self) -> Command {
        match self {
            Order::List => Command::List,
            Order::Kick { client, reason } => Command::Kick { client: ClientId(client), reason },
            Order::Ban { client, seconds, reason } => {
                Command::Ban { client: ClientId(client), seconds: seconds.unwrap_or(0), reason }
            }
            Order::Say { text } => Command::Say { text },
        }
    }
}

/// Runs `operate`.
///
/// # Errors
/// If there is no such server, it does not let us in, or the command was not done.
pub fn operate(options: &Operate) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        options.target.require();
        let (endpoint, address) = options.target.endpoint()?;
        // Somebody who only looks: an operator at work has no avatar.
        let config =
            SessionConfig::default().with_role(Role::Viewer).with_name("operator").with_token(options.target.token()?);
        let session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
        connection.session.command(options.order.clone().command());
        connection.flush().await?;
        let answer = async {
            loop {
                connection.arrive().await?;
                while let Some(event) = connection.session.poll_event() {
                    match event {
                        Event::Clients(entries) => print(&list(&entries)),
                        Event::Done(ok, text) => return anyhow::Ok((ok, text)),
                        _ => {}
                    }
                }
            }
        };
        let answer = tokio::time::timeout(PATIENCE, answer).await;
        connection.close().await;
        endpoint.wait_idle().await;
        let (ok, text) = answer.context("the server does not answer")??;
        anyhow::ensure!(ok, "{text}");
        print(&format!("{text}\n"));
        Ok(())
    })
}

fn list(entries: &[ClientEntry]) -> String {
    let line = |entry: &ClientEntry| {
        let rtt = entry.rtt_micros.map_or("      -".to_owned(), |rtt| format!("{:7.1}", f64::from(rtt) / 1e3));
        let away = if entry.away { "  away" } else { "" };
        let (client, seconds, avatars, rank) = (entry.client.0, entry.seconds, entry.avatars, entry.rank.name());
        // What people call themselves is theirs to choose: no line ends or colours of theirs on our terminal.
        let (name, subject) = (entry.name.escape_debug(), entry.subject.escape_debug());
        format!("{client:>6} {rank:<8} {avatars:>7} {seconds:>8} {rtt} ms  {name} ({subject}){away}\n")
    };
    let head =
        format!("{:>6} {:<8} {:>7} {:>8} {:>7}     name (subject)\n", "client", "rank", "avatars", "seconds", "rtt");
    entries.iter().map(line).fold(head, |text, line| text + &line)
}
