//! Where beside its point does a label go, so that no two texts overlap?
//!
//! Greedy, in the order given: the nearest of a few places around the point that is free. Finding the best for all
//! at once is NP-hard and looks no better for the dozens of points that a reader can take in.

/// A rectangle in the picture: left, top, right, bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Area {
    pub left: i32,
    pub top: i32,
    pub right: i32,
    pub bottom: i32,
}

impl Area {
    pub(super) fn around(x: i32, y: i32, reach: i32) -> Self {
        Self { left: x - reach, top: y - reach, right: x + reach, bottom: y + reach }
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right && other.left < self.right && self.top < other.bottom && other.top < self.bottom
    }

    fn contains(&self, other: &Self) -> bool {
        self.left <= other.left && other.right <= self.right && self.top <= other.top && other.bottom <= self.bottom
    }
}

/// A label to place: its point, and width and height of its text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    pub at: (i32, i32),
    pub size: (i32, i32),
}

/// Where a label goes, and whether it is far enough from its point to need a line to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spot {
    pub area: Area,
    pub leader: bool,
}

/// Finds a place within `frame` for each label that covers no mark and no
/// other label. `None` where there is none near enough.
pub(super) fn place(labels: &[Wanted], marks: &[Area], frame: Area, gap: i32) -> Vec<Option<Spot>> {
    let mut taken = marks.to_vec();
    let mut spots = Vec::with_capacity(labels.len());
    for &Wanted { at: (x, y), size: (width, height) } in labels {
        let mut found = None;
        'search: for ring in 0..RINGS {
            let far = gap + ring * height * 3 / 4;
            // Beside first: that is where a reader looks.
            let aside = [(x + far, y - height / 2), (x - far - width, y - height / 2)];
            let over = [(x - width / 2, y - far - height), (x - width / 2, y + far)];
            let near = far * 7 / 10;
            let diagonal = [
                (x + near, y - near - height),
                (x + near, y + near),
                (x - near - width, y - near - height),
                (x - near - width, y + near),
            ];
            for (left, top) in aside.into_iter().chain(over).chain(diagonal) {
                let area = Area { left, top, right: left + width, bottom: top + height };
                if frame.contains(&area) && !taken.iter().any(|other| area.overlaps(other)) {
                    found = Some(Spot { area, leader: ring > 0 });
                    taken.push(area);
                    break 'search;
                }
            }
        }
        spots.push(found);
    }
    spots
}

/// How many times farther away a place is looked for; beyond that, a label no longer seems to belong to its point.
const RINGS: i32 = 5;

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Area = Area { left: 0, top: 0, right: 1000, bottom: 500 };

    #[test]
    fn labels_of_one_point_do_not_overlap() {
        let labels = vec![Wanted { at: (500, 250), size: (120, 20) }; 8];
        let spots = place(&labels, &[Area::around(500, 250, 8)], FRAME, 10);
        let areas: Vec<Area> = spots.iter().flatten().map(|spot| spot.area).collect();
        assert_eq!(areas.len(), 8);
        for (i, a) in areas.iter().enumerate() {
            assert!(areas[..i].iter().all(|b| !a.overlaps(b)));
        }
    }

    #[test]
    fn a_label_keeps_within_the_frame_or_is_left_out() {
        let (near_edge, too_long) =
            (Wanted { at: (995, 5), size: (120, 20) }, Wanted { at: (500, 250), size: (2000, 20) });
        let spots = place(&[near_edge, too_long], &[], FRAME, 10);
        assert!(FRAME.contains(&spots[0].unwrap().area));
        assert_eq!(spots[1], None);
    }
}
