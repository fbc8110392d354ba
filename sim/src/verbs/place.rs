//! Where a recorded crowd goes: options that `measure` and `replay` share.

use clap::Args;
use eyeline_server::app::number;
use eyeline_sim::trace::Placement;
use glam::DVec3;

/// Where a recording lies in the world.
#[derive(Args, Clone)]
pub struct Place {
    /// Where the recording's origin lies in the world, metres [default: its middle at the most central place where avatars
    /// start]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    pub trace_origin: Option<DVec3>,

    /// Turn of the recording about +Y, radians
    #[arg(long, value_name = "RADIANS", default_value_t = 0.0, allow_hyphen_values = true, requires = "trace_origin",
        value_parser = number(-7.0..=7.0, "radians"))]
    trace_heading: f64,

    /// World metres a recorded metre; everybody's speed is scaled with it
    #[arg(long, value_name = "SCALE", default_value_t = 1.0, requires = "trace_origin",
        value_parser = number(0.001..=1000.0, ""))]
    trace_scale: f64,
}

impl Place {
    /// The place that was named, if one was.
    pub fn placement(&self) -> Option<Placement> {
        let (heading, scale) = (self.trace_heading, self.trace_scale);
        self.trace_origin.map(|origin| Placement { origin, heading, scale })
    }
}

fn point(text: &str) -> Result<DVec3, String> {
    let parsed: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match parsed.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|x| x.abs() <= 2e6) => Ok(DVec3::new(x, y, z)),
        _ => Err("give three numbers of at most 2000000 m, as in 12,0,-3.5".to_owned()),
    }
}
