//! `serve`: the server, with a world from a file or one made on the spot.

use std::path::PathBuf;

use clap::Args;
use eyeline_server::app::{self, ServeOptions};
use eyeline_server::config::Flags;
use eyeline_server::model::Model;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;
use eyeline_sim::stage::load_model;

/// Options of `serve`.
#[derive(Args)]
pub struct Serve {
    /// The model: a .glb, or a .gltf with its buffers beside it. One that says nothing of what moves is taken as a game
    /// map: two-sided, and avatars start at NAME.places.json
    #[arg(long, value_name = "FILE", required_unless_present = "rooms")]
    world: Option<PathBuf>,

    /// What moves in the model, and where avatars start [default: NAME.world.toml beside the model, if there is one]
    #[arg(long, value_name = "FILE", requires = "world", conflicts_with = "rooms")]
    world_file: Option<PathBuf>,

    /// Instead of a model, make a building of so many rooms, by --seed or else by seed 7
    #[arg(long, value_name = "COLUMNSxROWS", conflicts_with = "world", value_parser = columns_by_rows)]
    rooms: Option<(u32, u32)>,

    #[command(flatten)]
    serve: Flags<ServeOptions>,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim serve --rooms 10x10
  eyeline-sim serve --world out/rooms.glb --ready-file out/ready.txt --listen 127.0.0.1:0
  eyeline-sim serve --world oa_dm2.glb --policy oracle --avatar-speed 3";

fn columns_by_rows(text: &str) -> Result<(u32, u32), String> {
    let parsed =
        text.split_once(['x', '×']).and_then(|(columns, rows)| Some((columns.parse().ok()?, rows.parse().ok()?)));
    parsed.ok_or_else(|| "give two whole numbers, as in 10x10".to_owned())
}

/// Serves.
pub fn run(options: &Serve) -> anyhow::Result<()> {
    // The world is for the flags to say: what the file says of it is for `eyeline-server`.
    let serve = options.serve.load(&["world", "world_file"])?.options;
    let (model, notes) = match (&options.world, options.rooms) {
        (_, Some((columns, rows))) => {
            let seed = serve.seed.unwrap_or(RoomsRules::default().seed);
            let made = rooms::make(&RoomsRules { columns, rows, seed, ..RoomsRules::default() })?;
            (Model::from_bytes(made.glb, "rooms.glb", Some(made.world))?, Vec::new())
        }
        (Some(world), None) => {
            let (model, _, notes) = load_model(world, options.world_file.as_deref())?;
            (model, notes)
        }
        (None, None) => anyhow::bail!("which world? give --world FILE or --rooms COLUMNSxROWS"),
    };
    app::serve(&serve, model, &notes)
}
