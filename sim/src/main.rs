//! `eyeline-sim`: makes worlds, runs them, and measures.

fn main() -> anyhow::Result<()> {
    let text = eyeline_sim::demo::run(std::path::Path::new("out/demo"))?;
    print!("{text}");
    Ok(())
}
