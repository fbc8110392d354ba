//! `eyeline-sim`: makes worlds, runs them, and measures.

mod verbs;

use std::process::ExitCode;

use clap::Parser;

/// Makes worlds, fills them with people, runs them, and measures what clients were told against the truth
///
/// Without a verb it runs the demo: 10×10 furnished rooms, 32 people, three policies, in under a minute.
///
/// RUST_LOG=debug tells more on standard error.
#[derive(Parser)]
#[command(version, max_term_width = 100, after_long_help = EXAMPLES)]
struct Options {
    #[command(subcommand)]
    verb: Option<verbs::Verb>,
}

const EXAMPLES: &str = "Examples:
  eyeline-sim                                                  the demo
  eyeline-sim scene rooms --columns 3 --rows 3 --out out/rooms.glb
  eyeline-sim serve --world out/rooms.glb --ready-file out/ready.txt
  eyeline-sim swarm --server-file out/ready.txt --world out/rooms.glb --clients 32 --seconds 20";

fn main() -> ExitCode {
    let options = Options::parse();
    // `serve` writes logs as its settings say.
    if !matches!(options.verb, Some(verbs::Verb::Serve(_))) {
        eyeline_server::app::init_logs();
    }
    let ran = match options.verb {
        Some(verb) => verbs::run(&verb),
        None => verbs::demo(),
    };
    match ran {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", eyeline_server::app::one_line(&error));
            ExitCode::FAILURE
        }
    }
}
