//! `scene`: makes a world and writes it.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use eyeline_sim::scene::building::{self, BuildingRules};
use eyeline_sim::scene::city::{self, CityRules};
use eyeline_sim::scene::engine::{self, EngineRules};
use eyeline_sim::scene::made::MadeModel;
use eyeline_sim::scene::office::{self, OfficeRules};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;
use eyeline_sim::scene::seminar::{self, SeminarRules};
use eyeline_sim::scene::tower::{self, TowerRules};
use eyeline_sim::scene::vessels::{self, VesselsRules};

/// The makers.
#[derive(Subcommand)]
pub enum Scene {
    /// A building of rooms joined by doors, with a table and four chairs in each
    Rooms(Rooms),
    /// What cullers are measured on: 22×22 rooms with doors, 8 pieces of furniture of 256 triangles in each, and cameras
    Building(Building),
    /// Floors of furnished offices along corridors, joined by a stairwell: about a million triangles
    Office(Office),
    /// Thirty furnished houses along streets, with a path through street, roofs and rooms: about 500,000 triangles
    City(City),
    /// Five machines of dense parts, with a path around them: about 810,000 triangles
    Engine(Engine),
    /// One room full of chairs, with a path along and over them: about 45,000 triangles
    Seminar(Seminar),
    /// 54 storeys around an atrium: about a million triangles in front of each other
    Tower(Tower),
    /// A tree of tubes that hide nearly nothing, with a path around it: about 420,000 triangles
    Vessels(Vessels),
}

/// Rules of `rooms`. The maker checks them, and names what is wrong.
#[derive(Args)]
pub struct Rooms {
    /// Rooms along +X
    #[arg(long, value_name = "N", default_value_t = RoomsRules::default().columns)]
    columns: u32,

    /// Rooms along +Z
    #[arg(long, value_name = "N", default_value_t = RoomsRules::default().rows)]
    rows: u32,

    /// Side of a room from wall to wall, middle to middle, metres
    #[arg(long, value_name = "METRES", default_value_t = RoomsRules::default().room)]
    room: f64,

    /// From the floor to the ceiling, metres
    #[arg(long, value_name = "METRES", default_value_t = RoomsRules::default().height)]
    height: f64,

    /// Thickness of a wall, metres
    #[arg(long, value_name = "METRES", default_value_t = RoomsRules::default().wall)]
    wall: f64,

    /// Width of a door, metres
    #[arg(long, value_name = "METRES", default_value_t = RoomsRules::default().door_width)]
    door_width: f64,

    /// Height of a door, metres
    #[arg(long, value_name = "METRES", default_value_t = RoomsRules::default().door_height)]
    door_height: f64,

    /// Leave out tables and chairs
    #[arg(long)]
    bare: bool,

    /// Share of the chairs that move to and from their table, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = RoomsRules::default().moving_share)]
    moving_share: f64,

    /// Decides doors, furniture, paths and spawn points; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = RoomsRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.world.toml and NAME.rooms.json are written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `building`. The maker checks them, and names what is wrong.
#[derive(Args)]
pub struct Building {
    /// Rooms along +X, each 6×6×3 m
    #[arg(long, value_name = "N", default_value_t = BuildingRules::default().columns)]
    columns: u32,

    /// Rooms along +Z
    #[arg(long, value_name = "N", default_value_t = BuildingRules::default().rows)]
    rows: u32,

    /// Pieces of furniture in each room; 64 is about the most that fit
    #[arg(long, value_name = "N", default_value_t = BuildingRules::default().objects_per_room)]
    objects_per_room: u32,

    /// Cameras at eye height in random rooms, level, 90° across; the figures take 48, and 60 with 64 objects a room
    #[arg(long, value_name = "N", default_value_t = BuildingRules::default().cameras)]
    cameras: u32,

    /// Decides doors, furniture and cameras; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = BuildingRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json and NAME.places.json are written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `office`.
#[derive(Args)]
pub struct Office {
    /// Floors on top of each other
    #[arg(long, value_name = "N", default_value_t = OfficeRules::default().floors)]
    floors: u32,

    /// Cameras in offices, corridors and lobbies
    #[arg(long, value_name = "N", default_value_t = OfficeRules::default().cameras)]
    cameras: u32,

    /// Decides doors, furniture and cameras; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = OfficeRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `tower`.
#[derive(Args)]
pub struct Tower {
    /// Modules on top of each other, each of one storey
    #[arg(long, value_name = "N", default_value_t = TowerRules::default().modules)]
    modules: u32,

    /// Cameras on galleries and in rooms
    #[arg(long, value_name = "N", default_value_t = TowerRules::default().cameras)]
    cameras: u32,

    /// Decides doors, furniture, turns and cameras; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = TowerRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `city`.
#[derive(Args)]
pub struct City {
    /// Houses along +X
    #[arg(long, value_name = "N", default_value_t = CityRules::default().columns)]
    columns: u32,

    /// Blocks of two rows of houses along +Z
    #[arg(long, value_name = "N", default_value_t = CityRules::default().blocks)]
    blocks: u32,

    /// Views of the path
    #[arg(long, value_name = "N", default_value_t = CityRules::default().cameras)]
    cameras: u32,

    /// Decides sizes and furniture of houses; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = CityRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `engine`.
#[derive(Args)]
pub struct Engine {
    /// Machines side by side
    #[arg(long, value_name = "N", default_value_t = EngineRules::default().copies)]
    copies: u32,

    /// Views of the path
    #[arg(long, value_name = "N", default_value_t = EngineRules::default().cameras)]
    cameras: u32,

    /// Decides where pipes and bolts are; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = EngineRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `seminar`.
#[derive(Args)]
pub struct Seminar {
    /// Chairs in a row
    #[arg(long, value_name = "N", default_value_t = SeminarRules::default().columns)]
    columns: u32,

    /// Rows of chairs
    #[arg(long, value_name = "N", default_value_t = SeminarRules::default().rows)]
    rows: u32,

    /// Views of the path
    #[arg(long, value_name = "N", default_value_t = SeminarRules::default().cameras)]
    cameras: u32,

    /// Decides how chairs are left; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = SeminarRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

/// Rules of `vessels`.
#[derive(Args)]
pub struct Vessels {
    /// Generations of vessels, each of twice as many
    #[arg(long, value_name = "N", default_value_t = VesselsRules::default().levels)]
    levels: u32,

    /// Views of the path
    #[arg(long, value_name = "N", default_value_t = VesselsRules::default().cameras)]
    cameras: u32,

    /// Decides bends and forks; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = VesselsRules::default().seed)]
    seed: u64,

    /// Where to write the model; NAME.cameras.json is written beside it
    #[arg(long, value_name = "FILE.glb")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim scene rooms --out out/rooms.glb
  eyeline-sim scene rooms --columns 3 --rows 3 --seed 8 --moving-share 1 --out out/small.glb
  eyeline-sim scene rooms --columns 40 --rows 40 --bare --door-width 0.9 --out out/maze.glb
  eyeline-sim scene building --seed 3 --out out/building.glb
  eyeline-sim scene building --objects-per-room 64 --cameras 60 --out out/crowded.glb
  eyeline-sim scene office --out out/office.glb
  eyeline-sim scene city --out out/city.glb
  eyeline-sim scene engine --out out/engine.glb
  eyeline-sim scene seminar --out out/seminar.glb
  eyeline-sim scene vessels --levels 9 --out out/vessels.glb
  eyeline-sim scene tower --modules 10 --out out/tower.glb";

/// Makes and writes a scene.
pub fn run(scene: &Scene) -> anyhow::Result<()> {
    let text = match scene {
        Scene::Rooms(options) => write_rooms(options)?,
        Scene::Building(options) => write_building(options)?,
        &Scene::Office(Office { floors, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&office::make(&OfficeRules { floors, cameras, seed })?, out)?
        }
        &Scene::City(City { columns, blocks, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&city::make(&CityRules { columns, blocks, cameras, seed })?, out)?
        }
        &Scene::Engine(Engine { copies, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&engine::make(&EngineRules { copies, cameras, seed })?, out)?
        }
        &Scene::Seminar(Seminar { columns, rows, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&seminar::make(&SeminarRules { columns, rows, cameras, seed })?, out)?
        }
        &Scene::Vessels(Vessels { levels, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&vessels::make(&VesselsRules { levels, cameras, seed })?, out)?
        }
        &Scene::Tower(Tower { modules, cameras, seed, ref out }) => {
            check_name(out)?;
            write_made(&tower::make(&TowerRules { modules, cameras, seed })?, out)?
        }
    };
    super::print(&text);
    Ok(())
}

/// A model's loader goes by the ending of its name.
fn check_name(out: &Path) -> anyhow::Result<()> {
    if out.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("glb")) {
        anyhow::bail!("--out {}: the name of a model ends in .glb", out.display());
    }
    Ok(())
}

fn write_rooms(options: &Rooms) -> anyhow::Result<String> {
    check_name(&options.out)?;
    let made = rooms::make(&RoomsRules {
        columns: options.columns,
        rows: options.rows,
        room: options.room,
        height: options.height,
        wall: options.wall,
        door_width: options.door_width,
        door_height: options.door_height,
        furnished: !options.bare,
        moving_share: options.moving_share,
        seed: options.seed,
    })?;
    made.write(&options.out)?;
    Ok(format!(
        "{}: {} rooms, {} triangles, {} bytes; {} objects, {} spawn points in {}\n",
        options.out.display(),
        made.plan.rooms.len(),
        made.triangles,
        made.glb.len(),
        made.world.objects.len(),
        made.world.spawns.len(),
        options.out.with_extension("world.toml").display(),
    ))
}

fn write_made(made: &MadeModel, out: &Path) -> anyhow::Result<String> {
    made.write(out)?;
    Ok(format!(
        "{}: {} triangles, {} bytes; {} cameras in {}\n",
        out.display(),
        made.triangles,
        made.glb.len(),
        made.cameras.cameras.len(),
        out.with_extension("cameras.json").display(),
    ))
}

fn write_building(options: &Building) -> anyhow::Result<String> {
    check_name(&options.out)?;
    let &Building { columns, rows, objects_per_room, cameras, seed, .. } = options;
    let made = building::make(&BuildingRules { columns, rows, objects_per_room, cameras, seed })?;
    made.write(&options.out)?;
    Ok(format!(
        "{}: {} rooms, {} triangles of walls, {} in all, {} objects, {} bytes; {} cameras in {}\n",
        options.out.display(),
        made.plan.rooms.len(),
        made.wall_triangles,
        made.triangles,
        made.objects.len(),
        made.glb.len(),
        made.cameras.cameras.len(),
        options.out.with_extension("cameras.json").display(),
    ))
}
