//! What can be chosen, and what is counted.

/// How a [`crate::LargeOccluder`] is made. Any value is legal.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LargeOccluderRules {
    /// Polygons that a cell keeps for each of the 8 viewing directions: the paper's k. 0 leaves view-frustum culling alone, the
    /// baseline of the paper's tables. More find more hidden, at a cost per node. Default 32, as in the paper; cut to 64.
    pub occluders: usize,
    /// Only the largest so many polygons of the scene can be occluders. Default 8192.
    pub polygons_max: usize,
    /// Least area of an occluder in square metres; what is smaller is a detail, culled but never tested against. Default 0.1.
    pub area_min: f64,
    /// Whether polygons hide together what none hides alone (§2). Default true.
    pub joint: bool,
    /// Whether objects and clusters that are left are tested against what is large near *them* (§3.2). Default true.
    pub details: bool,
    /// How the kD-tree is cut. By default as [`crate::KdRules`], with up to 2,048 triangles in a cell: the paper's tree has 250
    /// nodes, and furniture is tested by itself.
    pub cells: crate::KdRules,
    /// Relations that a scratch keeps before it forgets them all. Default 262,144: about 120 MB, of which a scene of a million triangles needs most.
    pub relations_max: usize,
}

impl Default for LargeOccluderRules {
    fn default() -> LargeOccluderRules {
        LargeOccluderRules {
            occluders: 32,
            polygons_max: 8192,
            area_min: 0.1,
            joint: true,
            details: true,
            cells: crate::KdRules::default().with_max_triangles_per_leaf(2048),
            relations_max: 1 << 18,
        }
    }
}

impl LargeOccluderRules {
    /// The rules with another number of occluders.
    pub fn with_occluders(self, occluders: usize) -> LargeOccluderRules {
        LargeOccluderRules { occluders, ..self }
    }

    /// The rules with another limit of polygons.
    pub fn with_polygons_max(self, polygons_max: usize) -> LargeOccluderRules {
        LargeOccluderRules { polygons_max, ..self }
    }

    /// The rules with another least area.
    pub fn with_area_min(self, area_min: f64) -> LargeOccluderRules {
        LargeOccluderRules { area_min, ..self }
    }

    /// The rules with or without joint occluders.
    pub fn with_joint(self, joint: bool) -> LargeOccluderRules {
        LargeOccluderRules { joint, ..self }
    }

    /// The rules with or without tests of details.
    pub fn with_details(self, details: bool) -> LargeOccluderRules {
        LargeOccluderRules { details, ..self }
    }

    /// The rules with other cells.
    pub fn with_cells(self, cells: crate::KdRules) -> LargeOccluderRules {
        LargeOccluderRules { cells, ..self }
    }

    /// The rules with another limit of relations.
    pub fn with_relations_max(self, relations_max: usize) -> LargeOccluderRules {
        LargeOccluderRules { relations_max, ..self }
    }
}

/// What one cull came to: the counts behind the paper's tables 1 to 3 and its §4.1. Times are a driver's to take.
///
/// Table 1 is `primitives` over all, with the default rules and with `occluders` 0. Table 2 is time, for the same two. Table 3
/// is time against the speed of the eye, or `work()`, which no machine's mood changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LargeOccluderStats {
    /// Polygons that could hide something from this eye: chosen, turned to it and clear of it.
    pub occluders: usize,
    /// Nodes of the kD-tree that were looked at, those outside the frustum included.
    pub nodes_visited: usize,
    /// Those of them in the frustum: what the paper calls maintained.
    pub nodes_in_frustum: usize,
    /// Nodes hidden by one polygon.
    pub nodes_hidden: usize,
    /// Nodes hidden by several polygons together.
    pub nodes_hidden_jointly: usize,
    /// Leaves that may be seen.
    pub leaves_visible: usize,
    /// Pairs of polygon and box whose planes were computed.
    pub relations_made: usize,
    /// Pairs whose planes were looked at, those just made included.
    pub relations_tested: usize,
    /// Pairs whose answer of an earlier frame still held.
    pub relations_reused: usize,
    /// Planes that the eye's distance was taken from.
    pub planes_tested: usize,
    /// Sets of polygons that were tried as joint occluders.
    pub joint_tests: usize,
    /// Boxes, of nodes, objects or clusters, that a joint occluder hid.
    pub joint_occluders: usize,
    /// Boxes of objects and clusters that were looked at.
    pub details_tested: usize,
    /// Those of them that were hidden.
    pub details_hidden: usize,
    /// Primitives reported as visible.
    pub primitives: usize,
}

impl LargeOccluderStats {
    /// What the cull cost: nodes and details looked at, planes tested, planes made (about ten times the price) and joint tests.
    pub fn work(&self) -> usize {
        self.nodes_visited + self.details_tested + self.planes_tested + 10 * self.relations_made + self.joint_tests
    }
}
