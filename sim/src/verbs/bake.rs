//! `bake`: makes the table of the policy `pvs`.

use std::path::PathBuf;

use clap::Args;
use eyeline_server::app::number;
use eyeline_sim::bake::{BakeConfig, bake};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;

use super::measure::columns_by_rows;

/// Options of `bake`.
#[derive(Args)]
pub struct Bake {
    /// The model: a .glb or .gltf, as `measure` and `serve` take it
    #[arg(long, value_name = "FILE", required_unless_present = "rooms")]
    world: Option<PathBuf>,

    /// What moves, if not in NAME.world.toml
    #[arg(long, value_name = "FILE", requires = "world")]
    world_file: Option<PathBuf>,

    /// Instead of a file, a made building of so many furnished rooms, by --seed
    #[arg(long, value_name = "COLUMNSxROWS", conflicts_with = "world", value_parser = columns_by_rows)]
    rooms: Option<(u32, u32)>,

    /// Side of a cell, metres: smaller ones hide more and cost time and memory
    #[arg(long, value_name = "METRES", default_value_t = BakeConfig::default().cell, value_parser = number(0.01..=1e7, "m"))]
    cell: f64,

    /// Eyes in each column of cells, on each of its floors; more miss less
    #[arg(long, value_name = "N", default_value_t = BakeConfig::default().samples,
        value_parser = clap::value_parser!(u32).range(1..=100_000))]
    samples: u32,

    /// Decides where eyes stand, and the rooms
    #[arg(long, value_name = "N", default_value_t = BakeConfig::default().seed)]
    seed: u64,

    /// Where to write the table
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim bake --world building.glb --cell 3 --samples 32 --out building.pvs
  eyeline-sim serve --world building.glb --policy pvs --pvs building.pvs
  eyeline-sim bake --rooms 10x10 --out out/rooms.pvs
  eyeline-sim measure --rooms 10x10 --policies visible,pvs --pvs out/rooms.pvs";

/// Bakes.
pub fn run(options: &Bake) -> anyhow::Result<()> {
    let stage = match (&options.world, options.rooms) {
        (Some(world), _) => Stage::load(world, options.world_file.as_deref())?,
        (None, Some((columns, rows))) => {
            Stage::made(&RoomsRules { columns, rows, seed: options.seed, ..RoomsRules::default() })?
        }
        (None, None) => anyhow::bail!("which world? give --world FILE or --rooms COLUMNSxROWS"),
    };
    let config = BakeConfig { cell: options.cell, samples: options.samples, seed: options.seed };
    let table = bake(&stage, &config)?;
    table.write(&options.out)?;
    let (facts, grid) = (table.facts(), table.grid());
    let size = grid.size();
    super::print(&format!(
        "cells        {} of {} m ({} × {} × {}); an eye was in {}\n\
         eyes         {}, sampled: what is seen only from between them is missed\n\
         seen         {:.1} % of all cells from a cell, mean of those that do not see everything\n\
         table        {}\n",
        grid.cells(),
        grid.cell(),
        size.x,
        size.y,
        size.z,
        facts.cells_seen_from,
        facts.eyes,
        table.share_seen() * 100.0,
        options.out.display(),
    ));
    Ok(())
}
