//! Makes a building of rooms: `cargo run --example make_rooms -- out/rooms.glb 10 10 7`.

use std::path::PathBuf;

use anyhow::Context;
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let model = PathBuf::from(args.next().context("say where to write the .glb, then columns, rows and seed")?);
    let numbers: Vec<u64> =
        args.map(|arg| arg.parse().with_context(|| format!("not a number: {arg}"))).collect::<Result<_, _>>()?;
    let mut rules = RoomsRules::default();
    if let [columns, rows, seed] = numbers[..] {
        (rules.columns, rules.rows, rules.seed) = (u32::try_from(columns)?, u32::try_from(rows)?, seed);
    }
    let scene = rooms::make(&rules)?;
    scene.write(&model)?;
    println!(
        "{}: {} triangles, {} bytes, {} objects, {} spawn points",
        model.display(),
        scene.triangles,
        scene.glb.len(),
        scene.world.objects.len(),
        scene.world.spawns.len()
    );
    Ok(())
}
