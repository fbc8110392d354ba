//! `cull`: cullers side by side, with the exact set and the clock beside them.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::path::PathBuf;
use std::time::{Instant, SystemTime};

use clap::Args;
use eyeline_protocol::PlanSwitch;
use eyeline_server::app::number;
use eyeline_sim::cull::frames::write_frames;
use eyeline_sim::cull::gpu::{GpuSide, NoGpu, PREFIX};
use eyeline_sim::cull::report::{report, write_pictures};
use eyeline_sim::cull::run::run as run_cullers;
use eyeline_sim::cull::{
    AskedBudget, CameraPath, CullConfig, Registry, Setting, Sweep, SweepError, World, WorldRules, columns, row,
};
use eyeline_sim::report::{Progress, Run, rfc3339, table};
use eyeline_visibility::{AnyTessellation, Resolution};

use super::resolution;

/// Options of `cull`.
#[derive(Args)]
pub struct Cull {
    /// A .glb or .gltf, or a made world: building, city, engine, office, seminar, tower, vessels, rooms or room. Cameras come from NAME.cameras.json beside a file,
    /// or stand in the rooms of NAME.rooms.json, at the places of NAME.places.json, or on floors found with rays
    #[arg(long, value_name = "FILE|NAME", default_value = "building")]
    world: String,

    /// Cullers to compare: all, or names; a wrong name lists them
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "all")]
    cullers: Vec<String>,

    /// What the culler `planned` leaves out: as counted (auto), nothing (full), or frustum, occlusion and prisms =on or =off
    #[arg(long, value_name = "auto|full|STAGE=on,…", default_value_t)]
    plan: PlanSwitch,

    /// Tessellations to sweep, all or names [default: each culler's best]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tessellation: Vec<String>,

    /// A file of `eyeline-sim tessellate` for this very scene: used in place of making cells of its kind, and swept if no
    /// tessellation is named
    #[arg(long, value_name = "FILE")]
    tessellation_file: Option<PathBuf>,

    /// Query back ends to sweep, all or names [default: each culler's best]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    query: Vec<String>,

    /// Budgets to sweep: what PLP may draw by guess [default: cplp 100, hierarchical-z-plp 4000, others 10%]. Triangles (5000), a share of
    /// the scene's (10%), a multiple of the visible set of each view by itself, in triangles (2x), what the views before show to be worth
    /// while (auto), or a deadline after which no further cell is drawn (4ms; no two runs draw the same). A culler takes those that it can
    #[arg(long, value_name = "TRIANGLES|SHARE%|Nx|auto|Nms", value_delimiter = ',', allow_negative_numbers = true)]
    budgets: Vec<AskedBudget>,

    /// Sizes of the images to sweep, pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", value_delimiter = ',', default_value = "512x512", value_parser = resolution)]
    resolution: Vec<Resolution>,

    /// Radii of the ball of eyes to sweep, metres; 0 is a point
    #[arg(long, value_name = "METRES", value_delimiter = ',', default_value = "0", value_parser = number(0.0..=100.0, "m"))]
    eye_radius: Vec<f64>,

    /// Eyes of a ball whose exact sets are united, its middle included
    #[arg(long, value_name = "N", default_value_t = 33, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    eyes: u32,

    /// Views [default: the world's own cameras, else 200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    views: Option<u32>,

    /// Decides where cameras stand and the eyes of a ball
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// Seed of a made world [default: the maker's]
    #[arg(long, value_name = "N")]
    scene_seed: Option<u64>,

    /// Pieces of furniture in each room of `building` [default: 8]
    #[arg(long, value_name = "N")]
    objects_per_room: Option<u32>,

    /// Take nodes whose name begins so out of the static scene and ask about their boxes: `object.` in `building`
    #[arg(long, value_name = "PREFIX")]
    query_objects: Option<String>,

    /// Draw both sides of every face, or only what materials say [default: as the world says]
    #[arg(long, value_name = "BOOL")]
    two_sided: Option<bool>,

    /// Times that each view is culled against the clock; its time is their median
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    repeats: u32,

    /// Write the camera path that was used
    #[arg(long, value_name = "FILE.json")]
    record: Option<PathBuf>,

    /// Look along a recorded camera path instead
    #[arg(long, value_name = "FILE.json")]
    path: Option<PathBuf>,

    /// Run the cullers of a graphics adapter too, gpu-… (all, or those named), each with all its query back ends unless --query names
    /// some, and measure single queries. Needs a build with the feature gpu
    #[arg(long)]
    gpu: bool,

    /// Folder for report.html, report.json, report.csv, frames.csv (each view by itself) and the pictures
    #[arg(long, value_name = "DIR", default_value = "out/cull")]
    out: PathBuf,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim cull --world oa_dm2.glb --cullers all --views 200 --seed 7 --resolution 512x512

  The figures to beat, furniture asked about as boxes; then crowded, from five seeds one by one:
  eyeline-sim cull --world building --query-objects object. --resolution 1024x512
  eyeline-sim cull --world building --query-objects object. --objects-per-room 64 --scene-seed 3

  How much a guess should draw, and what a ball of eyes costs:
  eyeline-sim cull --world office --cullers frustum-backface,cplp --budgets 0,100,1000,10000
  eyeline-sim cull --world building --eye-radius 0,0.1,0.3,1 --eyes 1000 --views 20

  What PLP finds within a budget, of a city and of machines (Klosowski & Silva 2000, table 1):
  eyeline-sim cull --world city --cullers plp,plp-paper,centroid --tessellation all --budgets 1%,2%,5%,10%
  eyeline-sim cull --world engine --cullers plp,centroid --budgets 1%,2%,5%,10%
  eyeline-sim cull --world city --cullers plp-paper --tessellation octree,fine-octree

  The same by the visible set, by an automatic budget and by a deadline:
  eyeline-sim cull --world oa_dm2.glb --cullers plp,centroid --budgets 1x,2x,4x
  eyeline-sim cull --world vessels --cullers frustum-backface,plp --budgets auto,4ms

  What guessing costs beyond the frustum at equal triangles (overhead_ms, over_frustum):
  eyeline-sim cull --world city --cullers frustum-backface,plp,plp-paper --tessellation octree,delaunay --budgets 10%,100%

  What occupancy maps spare (Staneker 2003, table 2: visible_query_pixels) and take (over_unmapped), each back end with and without:
  eyeline-sim cull --world city --cullers cplp,cplp-occupancy,cplp-occupancy-always,cplp-batches --query all --repeats 7
  eyeline-sim cull --world city --cullers query-front-to-back,query-front-to-back-occupancy,query-front-to-back-batches

  Query back ends on the GPU beside the CPU's (a build with --features gpu), and what a query costs there:
  eyeline-sim cull --gpu --world office --cullers cplp,gpu-cplp,gpu-cplp-batches,gpu-hierarchical-z --views 20

  Cells that end at walls, and cells from a file:
  eyeline-sim cull --world office --cullers cplp --tessellation octree,kd-tree,prisms
  eyeline-sim cull --world city --cullers plp --tessellation-file city.tess

  The same views again:
  eyeline-sim cull --world rooms.glb --views 50 --record walk.json
  eyeline-sim cull --world rooms.glb --path walk.json

Exits with 1, after writing the report, if a culler that promises to lose nothing has a wrong pixel
or lost a primitive.";

/// The settings to run. Cullers of a graphics adapter take all their query back ends unless some are named: they are there to be
/// compared.
fn settings_of(registry: &Registry, sweep: &Sweep, has_gpu: bool) -> Result<Vec<Setting>, SweepError> {
    if !has_gpu || !sweep.queries.is_empty() {
        return registry.settings(sweep);
    }
    // Which cullers are meant, by name; a wrong one is refused here.
    let all = registry.settings(sweep)?;
    let mut settings: Vec<Setting> =
        all.iter().filter(|setting| !setting.culler.starts_with(PREFIX)).cloned().collect();
    let mut cullers: Vec<String> = all.iter().map(|setting| setting.culler.to_owned()).collect();
    cullers.retain(|name| name.starts_with(PREFIX));
    cullers.dedup();
    if !cullers.is_empty() {
        settings.extend(registry.settings(&Sweep { cullers, queries: vec!["all".into()], ..sweep.clone() })?);
    }
    Ok(settings)
}

/// Runs, writes the report, and fails if a promise was broken.
pub fn run(options: &Cull) -> anyhow::Result<()> {
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    let mut registry = Registry::standard();
    let mut sweep = Sweep {
        cullers: options.cullers.clone(),
        tessellations: options.tessellation.clone(),
        queries: options.query.clone(),
        budgets: options.budgets.clone(),
    };
    let mut gpu_notes = Vec::new();
    let gpu = match options.gpu.then(GpuSide::open) {
        None => None,
        Some(Ok(gpu)) => {
            registry = gpu.entries().into_iter().fold(registry, Registry::with);
            gpu_notes = gpu.notes();
            Some(gpu)
        }
        Some(Err(error @ NoGpu::NotBuilt)) => return Err(error.into()),
        // The rows of the CPU are worth having all the same.
        Some(Err(NoGpu::NoAdapter(why))) => {
            let line = format!("no rows of a GPU: {why}");
            eprintln!("{line}");
            gpu_notes.push(line);
            let is_named_gpu = |name: &String| name.starts_with(PREFIX);
            sweep.cullers.retain(|name| !is_named_gpu(name));
            sweep.queries.retain(|name| !is_named_gpu(name));
            None
        }
    };
    // Names first: a world may take long to load.
    settings_of(&registry, &sweep, gpu.is_some())?;
    let replayed = options.path.as_deref().map(CameraPath::read).transpose()?;
    let mut world = World::open(
        &options.world,
        &WorldRules {
            query_objects: options.query_objects.clone(),
            two_sided: options.two_sided,
            scene_seed: options.scene_seed,
            objects_per_room: options.objects_per_room,
            views: options.views,
        },
    )?;
    world.plan = options.plan;
    if let Some(file) = &options.tessellation_file {
        let made = AnyTessellation::read(&world.scene, file)?;
        if sweep.tessellations.is_empty() {
            sweep.tessellations = vec![made.name().to_owned()];
        }
        world.notes.push(format!("cells of kind {} from {}", made.name(), file.display()));
        world.tessellation = Some(made);
    }
    world.notes.append(&mut gpu_notes);
    let settings = settings_of(&registry, &sweep, gpu.is_some())?;
    let path = match replayed {
        Some(mut path) => {
            path.cameras.truncate(options.views.map_or(usize::MAX, |views| views as usize));
            path
        }
        None => world.cameras(options.views, options.seed),
    };
    if let Some(views) = options.views.filter(|views| path.cameras.len() < *views as usize) {
        world.notes.push(format!("{} views instead of {views}: there are no more cameras", path.cameras.len()));
    }
    if let Some(file) = &options.record {
        path.write(file)?;
    }
    let config = CullConfig {
        settings,
        resolutions: options.resolution.clone(),
        eye_radii: options.eye_radius.clone(),
        eyes: options.eyes as usize,
        repeats: options.repeats as usize,
        seed: options.seed,
    };
    let runs = config.resolutions.len() * config.eye_radii.len();
    let progress = Progress::new((runs * path.cameras.len()) as u64, "culling views");
    let outcome = run_cullers(&world, &path, &config, &registry, || progress.inc(1));
    progress.finish();
    let mut run = Run::here("Eyeline cull", Some(options.seed), started);
    run.wall_seconds = began.elapsed().as_secs_f64();
    let mut report = report(run, &world, &outcome, &config)?;
    let costs = gpu.map_or(Ok(Vec::new()), |gpu| gpu.measure(&mut report, &outcome))?;
    write_frames(&outcome.frames, &options.out)?;
    write_pictures(&mut report, &outcome, &options.out)?;
    let written = report.write(&options.out)?;
    let short: Vec<_> = columns().into_iter().filter(|column| row::SHORT.contains(&column.key.as_str())).collect();
    let told = outcome.notes.iter().filter(|_| options.gpu);
    let faults = told.chain(&costs).fold(String::new(), |text, line| text + line + "\n");
    super::print(&format!(
        "{}\n{faults}{}\nreport: {}\n",
        table(report.rows(), &short),
        report.headline,
        written.html.display()
    ));
    let broken: Vec<&str> = outcome.rows.iter().filter(|row| !row.ok).map(|row| row.culler.as_str()).collect();
    if !broken.is_empty() {
        anyhow::bail!(
            "{} promised to lose nothing; see wrong_pixels_max and lost_visible in the report",
            broken.join(", ")
        );
    }
    Ok(())
}
