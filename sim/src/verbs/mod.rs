//! What can be done from the command line: one file a verb, each with its options and what it prints.

mod bake;
mod cull;
mod link;
mod load;
mod measure;
mod place;
mod plan;
mod replay;
mod report;
mod scene;
mod serve;
mod soak;
mod stability;
mod swarm;
mod tessellate;
mod track;

use std::io::Write as _;
use std::path::Path;

use clap::Subcommand;
use eyeline_visibility::Resolution;

/// A verb and its options.
#[derive(Subcommand)]
pub enum Verb {
    /// Measure policies side by side: messages, bytes, misses, lateness and disclosure, with the truth beside them
    #[command(after_long_help = measure::EXAMPLES)]
    Measure(Box<measure::Measure>),
    /// Explain why a client shows an object at a moment, or not: runs a measurement in virtual time until then
    #[command(after_long_help = measure::WHY_EXAMPLES)]
    Why(Box<measure::Why>),
    /// Compare cullers: wrong pixels, what was kept and what was lost, z-tests and time
    #[command(after_long_help = cull::EXAMPLES)]
    Cull(Box<cull::Cull>),
    /// Make the cells of a scene once and keep them in a file, for `cull --tessellation-file`
    #[command(after_long_help = tessellate::EXAMPLES)]
    Tessellate(tessellate::Tessellate),
    /// Repeat the papers' experiments with trackers: work, time and messages, without a network
    #[command(after_long_help = track::EXAMPLES)]
    Track(Box<track::Track>),
    /// Make the table of the policy pvs: which cells of a world may be seen from which
    #[command(after_long_help = bake::EXAMPLES)]
    Bake(bake::Bake),
    /// Make a scene: a .glb with its world file
    #[command(subcommand, after_long_help = scene::EXAMPLES)]
    Scene(scene::Scene),
    /// Serve a world: `eyeline-server`, which also makes its world if told to
    #[command(after_long_help = serve::EXAMPLES)]
    Serve(serve::Serve),
    /// Fill a server with people: many headless clients in one process
    #[command(after_long_help = swarm::EXAMPLES)]
    Swarm(swarm::Swarm),
    /// How many people a server carries: server and swarm on a core each, against half a tick, memory a client, and bare QUIC
    #[command(after_long_help = load::EXAMPLES)]
    Load(Box<load::Load>),
    /// Fill a server with people who really walked: a recorded crowd behind one connection
    #[command(after_long_help = replay::EXAMPLES)]
    Replay(replay::Replay),
    /// Put a bad path between clients and a server: delay, jitter, loss, duplicates, reordering, a rate, blackouts
    #[command(after_long_help = link::EXAMPLES)]
    Link(Box<link::Link>),
    /// Keep every promise in thousands of towns made from seeds, in virtual time; or catch mutants that do not
    #[command(after_long_help = soak::EXAMPLES)]
    Soak(soak::Soak),
    /// Put several runs on one page, with one table, one plot of error against run time and one Pareto table over all
    #[command(after_long_help = report::EXAMPLES)]
    Report(report::Merge),
    /// What a scene needs and what is left out, with what was counted; and what leaving it in would cost
    #[command(after_long_help = plan::EXAMPLES)]
    Plan(plan::PlanVerb),
    /// Numbers that can go wrong: hard scenes, views, times, speeds and springs, each against an oracle
    #[command(after_long_help = stability::EXAMPLES)]
    Stability(stability::Stability),
}

/// Runs a verb.
pub fn run(verb: &Verb) -> anyhow::Result<()> {
    match verb {
        Verb::Measure(options) => measure::run(options),
        Verb::Why(options) => measure::explain(options),
        Verb::Cull(options) => cull::run(options),
        Verb::Tessellate(options) => tessellate::run(options),
        Verb::Track(options) => track::run(options),
        Verb::Bake(options) => bake::run(options),
        Verb::Scene(options) => scene::run(options),
        Verb::Serve(options) => serve::run(options),
        Verb::Swarm(options) => swarm::run(options),
        Verb::Load(options) => load::run(options),
        Verb::Replay(options) => replay::run(options),
        Verb::Link(options) => link::run(options),
        Verb::Soak(options) => soak::run(options),
        Verb::Report(options) => report::run(options),
        Verb::Plan(options) => plan::run(options),
        Verb::Stability(options) => stability::run(options),
    }
}

/// What is done without a verb.
pub fn demo() -> anyhow::Result<()> {
    print(&eyeline_sim::demo::run(Path::new("out/demo"))?);
    Ok(())
}

/// Writes to standard output at once. Who has closed it does not want to read, which is no reason to end.
fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Two whole numbers with an x between them.
fn pair(text: &str) -> Option<(u32, u32)> {
    let (a, b) = text.split_once(['x', '×'])?;
    Some((a.trim().parse().ok()?, b.trim().parse().ok()?))
}

/// The value of `--resolution`.
fn resolution(text: &str) -> Result<Resolution, String> {
    let size = pair(text).filter(|&(width, height)| (1..=8192).contains(&width) && (1..=8192).contains(&height));
    let size = size.ok_or_else(|| "give width and height from 1 to 8192 pixels, as in 320x240".to_owned())?;
    Ok(Resolution::new(size.0, size.1))
}
