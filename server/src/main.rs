//! `eyeline-server`: serves a world.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use eyeline_server::app::{self, ServeOptions};
use eyeline_server::model::Model;

/// Serves a world in which a client is told only about what it could see
///
/// The world is any .glb or .gltf file. What moves in it is said by NAME.world.toml beside it, or by the extras of its
/// nodes; without either only avatars move. On the first run the server makes itself a certificate; clients pin its
/// fingerprint, which is printed at the start.
///
/// RUST_LOG=debug tells more on standard error. Ctrl-C and SIGTERM end the server after it has told its clients.
#[derive(Parser)]
#[command(version, max_term_width = 100, after_long_help = EXAMPLES)]
struct Options {
    /// The model: a .glb, or a .gltf with its buffers beside it
    #[arg(long, value_name = "FILE")]
    world: PathBuf,

    /// What moves in the model, and where avatars start [default: NAME.world.toml beside the model, if there is one]
    #[arg(long, value_name = "FILE")]
    world_file: Option<PathBuf>,

    #[command(flatten)]
    serve: ServeOptions,
}

const EXAMPLES: &str = "Examples:
  eyeline-server --world rooms.glb
  eyeline-server --world rooms.glb --listen 0.0.0.0:4433 --identity /var/lib/eyeline --max-avatars 200
  eyeline-server --world city.glb --world-file busy.world.toml --policy broadcast --tick-hz 10";

fn main() -> ExitCode {
    let options = Options::parse();
    app::init_logs();
    let served = Model::load(&options.world, options.world_file.as_deref())
        .map_err(Into::into)
        .and_then(|model| app::serve(&options.serve, model, &[]));
    match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", app::one_line(&error));
            ExitCode::FAILURE
        }
    }
}
