//! `eyeline-server`: serves a world.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use eyeline_server::app;
use eyeline_server::config::options::ServerOptions;
use eyeline_server::config::{Flags, Loaded, USUAL_FILE, show};
use eyeline_server::model::Model;
use eyeline_server::token::verbs::{self, TokenVerb};

/// Serves a world in which a client is told only about what it could see
///
/// The world is any .glb or .gltf file. What moves in it is said by NAME.world.toml beside it, or by the extras of its
/// nodes; without either only avatars move. On the first run the server makes itself a certificate; clients pin its
/// fingerprint, which is printed at the start.
///
/// Every option may also be written in eyeline-server.toml or in a variable of the environment, which goes before the file
/// as flags go before both: `config example` writes such a file, `config print` says what is effective and why.
///
/// RUST_LOG=debug tells more on standard error. Ctrl-C and SIGTERM end the server after it has told its clients.
#[derive(Parser)]
#[command(version, max_term_width = 100, after_long_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Options {
    #[command(flatten)]
    server: Flags<ServerOptions>,

    #[command(subcommand)]
    verb: Option<Verb>,
}

/// What else there is to do.
#[derive(Subcommand)]
enum Verb {
    /// Shows, checks or writes settings
    #[command(subcommand)]
    Config(Config),
    /// Makes keys, issues tokens and revokes them
    #[command(subcommand)]
    Token(TokenVerb),
}

/// What can be done with settings.
#[derive(Subcommand)]
enum Config {
    /// Prints each effective setting and where it comes from; takes the flags that the server would be given
    Print(Print),
    /// Says what is wrong with the settings and the files that they name; takes the flags that the server would be given
    Check(Check),
    /// Prints a file with every setting, its default and what it means
    Example,
}

/// Options of `config print`.
#[derive(Args)]
struct Print {
    #[command(flatten)]
    server: Flags<ServerOptions>,
}

/// Options of `config check`.
#[derive(Args)]
struct Check {
    /// The file of settings [default: eyeline-server.toml in the current folder, if it is there]
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,

    #[command(flatten)]
    server: Flags<ServerOptions>,
}

const EXAMPLES: &str = "Examples:
  eyeline-server --world rooms.glb
  eyeline-server --world rooms.glb --listen 0.0.0.0:4433 --identity /var/lib/eyeline --max-avatars 200
  eyeline-server --world city.glb --world-file busy.world.toml --policy broadcast --tick-hz 10
  eyeline-server config example > eyeline-server.toml
  eyeline-server token key
  eyeline-server token issue --role actor --subject anna --valid 8h --key eyeline-identity/tokens.key";

fn main() -> ExitCode {
    let options = Options::parse();
    // Serving, they are as the settings say; else for people.
    if options.verb.is_some() {
        app::init_logs();
    }
    let ran = match options.verb {
        None => serve(&options.server),
        Some(Verb::Config(Config::Print(print))) => load(&print.server).map(|loaded| say(&show::effective(&loaded))),
        Some(Verb::Config(Config::Check(check))) => check_settings(&check),
        Some(Verb::Config(Config::Example)) => {
            say(&show::example::<ServerOptions>());
            Ok(())
        }
        Some(Verb::Token(verb)) => verbs::run(&verb, app::unix_time()).map(|said| {
            eprint!("{}", said.aside);
            say(&said.out);
        }),
    };
    match ran {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", app::one_line(&error));
            ExitCode::FAILURE
        }
    }
}

fn load(flags: &Flags<ServerOptions>) -> anyhow::Result<Loaded<ServerOptions>> {
    Ok(flags.load(&[])?)
}

fn serve(flags: &Flags<ServerOptions>) -> anyhow::Result<()> {
    let options = load(flags)?.options;
    app::init_logs_as(options.serve.watch.log);
    let world =
        options.world.with_context(|| format!("which world? give --world FILE, or world = … in {USUAL_FILE}"))?;
    let model = Model::load(&world, options.world_file.as_deref())?;
    app::serve(&options.serve, model, &[])
}

/// All that is wrong, a line each.
fn check_settings(check: &Check) -> anyhow::Result<()> {
    let flags = match &check.file {
        Some(file) => check.server.clone().with_file(file),
        None => check.server.clone(),
    };
    let problems = match flags.load(&[]) {
        Ok(loaded) => {
            let now = app::unix_time();
            for warning in eyeline_server::config::check::warnings(&loaded, now) {
                say(&format!("warning: {warning}\n"));
            }
            eyeline_server::config::check::problems(&loaded, now)
        }
        Err(error) => error.problems,
    };
    if problems.is_empty() {
        say("the settings are good\n");
        return Ok(());
    }
    say(&problems.iter().map(|problem| format!("{problem}\n")).collect::<String>());
    anyhow::bail!("the settings have so many problems: {}", problems.len());
}

fn say(text: &str) {
    app::print(text);
}
