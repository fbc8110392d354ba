//! `eyeline-client`: joins a world.

use std::process::ExitCode;

use clap::Parser;
use eyeline_client::app::{self, Command};
use eyeline_client::operate;

/// Joins a world, and hears only about what it could see
///
/// The client keeps a bound for everything that is hidden from it, culls every frame, and asks only about bounds that
/// became visible. It trusts exactly one server: the one whose fingerprint it is given.
///
/// RUST_LOG=debug tells more on standard error.
#[derive(Parser)]
#[command(version, max_term_width = 100, after_long_help = EXAMPLES)]
struct Options {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  eyeline-client headless --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --seconds 10
  eyeline-client headless --server-file ready.txt --world rooms.glb
  eyeline-client headless --help";

fn main() -> ExitCode {
    let options = Options::parse();
    app::init_logs();
    let ran = match options.command {
        Command::Headless(options) => app::headless(&options),
        Command::Operate(options) => operate::operate(&options),
        #[cfg(feature = "viewer")]
        Command::Shot(options) => eyeline_client::viewer::shot::shot(&options),
        #[cfg(feature = "viewer")]
        Command::Film(options) => eyeline_client::viewer::film::film(&options),
        #[cfg(feature = "viewer")]
        Command::View(options) => eyeline_client::viewer::view::view(&options),
    };
    match ran {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", app::one_line(&error));
            ExitCode::FAILURE
        }
    }
}
