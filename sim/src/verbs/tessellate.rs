//! `tessellate`: cells of a scene, made once and kept in a file.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use eyeline_sim::cull::{World, WorldRules};
use eyeline_visibility::AnyTessellation;

/// Options of `tessellate`.
#[derive(Args)]
pub struct Tessellate {
    /// A .glb or .gltf, or a made world: building, city, engine, office, seminar, tower, vessels, rooms or room
    #[arg(value_name = "FILE|NAME")]
    scene: String,

    /// Kind of cells: octree, kd-tree, delaunay or prisms
    #[arg(long, value_name = "NAME", default_value = "delaunay")]
    tessellation: String,

    /// Seed of a made world [default: the maker's]
    #[arg(long, value_name = "N")]
    scene_seed: Option<u64>,

    /// Take nodes whose name begins so out of the static scene, as `cull` does with the same option
    #[arg(long, value_name = "PREFIX")]
    query_objects: Option<String>,

    /// Draw both sides of every face, or only what materials say [default: as the world says]
    #[arg(long, value_name = "BOOL")]
    two_sided: Option<bool>,

    /// Write the cells, for `cull --tessellation-file`
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim tessellate city --tessellation delaunay --out city.tess
  eyeline-sim cull --world city --cullers plp --tessellation-file city.tess

  eyeline-sim tessellate oa_dm2.glb --tessellation kd-tree --out oa_dm2.tess

The file is for this very scene: `cull` refuses it for another, and where it was cut short or damaged.";

/// Makes the cells, writes them, and says what they took.
pub fn run(options: &Tessellate) -> anyhow::Result<()> {
    let rules = WorldRules {
        query_objects: options.query_objects.clone(),
        two_sided: options.two_sided,
        scene_seed: options.scene_seed,
        ..WorldRules::default()
    };
    let world = World::open(&options.scene, &rules)?;
    let triangles = world.scene.triangles().len();
    let began = Instant::now();
    let made = AnyTessellation::build(&options.tessellation, &world.scene)
        .with_context(|| format!("no {} of `{}`", options.tessellation, options.scene))?;
    let built = began.elapsed().as_secs_f64();
    let bytes = made.write(&world.scene, &options.out)?;
    let began = Instant::now();
    AnyTessellation::read(&world.scene, &options.out)?;
    let read = began.elapsed().as_secs_f64();
    let cells = made.plp_cells();
    let references = cells.reference_count();
    let scene_bytes = size_of_val(world.scene.triangles());
    super::print(&format!(
        "{} of '{}': {} cells over {triangles} triangles\n\
         built in {built:.2} s, read back in {read:.2} s\n\
         {:.2} references per triangle\n\
         {:.1} MB in memory, {:.0} % of the triangles' {:.1} MB; {:.1} MB in {}\n",
        made.name(),
        world.name,
        cells.len(),
        references as f64 / triangles.max(1) as f64,
        made.memory_bytes() as f64 / 1e6,
        100.0 * made.memory_bytes() as f64 / scene_bytes.max(1) as f64,
        scene_bytes as f64 / 1e6,
        bytes as f64 / 1e6,
        options.out.display(),
    ));
    Ok(())
}
