//! How does one walk through the offices? Round each floor along both corridors and lobbies, into an office every few metres,
//! and up the stairs.
//!
//! Coorg & Teller (1997, §4) walk a figure 8 through their floor. Ours has a core that only the stairwell crosses, so a floor is
//! a ring. About half of the way is in offices, as half of the cameras are.

use glam::{DVec2, DVec3};

use super::{ALONG, EYE_HEIGHT, HOLE, MadeError, Office, OfficeRules, ROWS, STAIRS, STOREY, WIDTH, build};

/// Least distance along a corridor between the doors of two offices that are visited.
const APART: f64 = 5.0;
/// How far before and behind a door one is in the middle of the corridor.
const TURN: f64 = 1.2;
/// The same for the corners of the ring.
const CORNER: f64 = 2.0;
/// How far into an office one is through the door, begins the turn, and turns.
const INTO: [f64; 3] = [0.95, 2.0, 3.2];
/// Half the width of the turn.
const HALF_TURN: f64 = 0.35;

/// Way points of the eye for a smooth curve that cuts corners no farther than the middles of its legs. For the floors and seed
/// of an office; the same rules give the same way.
///
/// # Errors
/// As [`super::make`].
pub fn walk(rules: &OfficeRules) -> Result<Vec<DVec3>, MadeError> {
    let (_, floors) = build(rules)?;
    let mut way = Vec::new();
    for (floor, offices) in floors.iter().enumerate() {
        let base = floor as f64 * STOREY;
        let even = floor.is_multiple_of(2);
        let corridors = [middle(ROWS[0].1, ROWS[1].0), middle(ROWS[2].1, ROWS[3].0)];
        let [here, there] = if even { corridors } else { [corridors[1], corridors[0]] };
        let eye = |at: DVec2, above: f64| DVec3::new(at.x, base + above + EYE_HEIGHT, at.y);
        way.extend(ring(offices, here, there).into_iter().map(|at| eye(at, 0.0)));
        if floor + 1 < floors.len() {
            way.extend(climb(even).map(|(at, above)| eye(at, above)));
        }
    }
    Ok(way)
}

fn middle(a: f64, b: f64) -> f64 {
    0.5 * (a + b)
}

/// Where the stairwell's doors are.
fn stair_door() -> f64 {
    (f64::from(STAIRS) + 0.5) * WIDTH
}

/// From the stairwell's door in the corridor `here` along it, back along the other one, and on to where it began.
fn ring(offices: &[Office], here: f64, there: f64) -> Vec<DVec2> {
    let (start, ends) = (stair_door(), [0.5 * WIDTH, (f64::from(ALONG) - 0.5) * WIDTH]);
    let mut way = Vec::new();
    for (corridor, from, to) in [(here, start, ends[0]), (there, ends[0], ends[1]), (here, ends[1], start)] {
        let along = (to - from).signum();
        // One is in the middle of corridors and lobbies, but for the corners.
        let lobby = |end: f64| DVec2::new(end, corridor + (middle(here, there) - corridor).signum() * CORNER);
        if from != start {
            way.extend([lobby(from), DVec2::new(from, corridor), DVec2::new(from + along * CORNER, corridor)]);
        } else {
            way.push(DVec2::new(from, corridor));
        }
        let mut beside: Vec<(f64, &Office)> = offices
            .iter()
            .filter(|office| (door_of(office) - corridor).abs() < 2.0)
            .map(|office| ((office.door - from) * along, office))
            .collect();
        beside.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut last = 0.0;
        for (distance, office) in beside {
            if distance >= last + APART && distance <= (to - from).abs() - APART {
                way.extend(visit(office, corridor, along));
                last = distance;
            }
        }
        if to != start {
            way.extend([DVec2::new(to - along * CORNER, corridor), DVec2::new(to, corridor), lobby(to)]);
        } else {
            way.push(DVec2::new(to, corridor));
        }
    }
    way
}

fn door_of(office: &Office) -> f64 {
    if office.door_up { office.cell.max.y } else { office.cell.min.y }
}

/// Into an office by the lane between its furniture, round, and out again.
fn visit(office: &Office, corridor: f64, along: f64) -> [DVec2; 10] {
    let (door, wall) = (office.door, door_of(office));
    let lane = middle(office.cell.min.x, office.cell.max.x);
    let inside = |x: f64, depth: f64| DVec2::new(x, wall + (wall - corridor).signum() * depth);
    let turn = along * HALF_TURN;
    [
        DVec2::new(door - along * TURN, corridor),
        DVec2::new(door, corridor),
        inside(door, INTO[0]),
        inside(lane - turn, INTO[1]),
        inside(lane - turn, INTO[2]),
        inside(lane + turn, INTO[2]),
        inside(lane + turn, INTO[1]),
        inside(door, INTO[0]),
        DVec2::new(door, corridor),
        DVec2::new(door + along * TURN, corridor),
    ]
}

/// Into the stairwell and up a flight, with the heights that the eye has climbed.
fn climb(even: bool) -> [(DVec2, f64); 5] {
    let (first, last) = if even { (HOLE.0, HOLE.1) } else { (HOLE.1, HOLE.0) };
    let on = (last - first).signum();
    // The flights of even floors are on the left.
    let x = stair_door() + if even { -1.0 } else { 1.0 } * 0.25 * WIDTH;
    let landing = |edge: f64, away: f64| edge + on * away;
    [
        (DVec2::new(stair_door(), landing(first, -1.2)), 0.0),
        (DVec2::new(x, landing(first, -0.6)), 0.0),
        (DVec2::new(x, first), 0.0),
        (DVec2::new(x, last), STOREY),
        (DVec2::new(stair_door(), landing(last, 1.2)), STOREY),
    ]
}
