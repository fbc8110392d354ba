//! The cullers of `eyeline-visibility`: names, what can be chosen for each, and how each is made.

use std::sync::Arc;

use eyeline_visibility::{
    Budget, CplpCuller, CplpQueryCuller, FrustumBackface, HierarchicalZ, LargeOccluder, LargeOccluderRules, MaskedCplp,
    Occupancy, Plp, PlpCells, PlpRules, QueryFrontToBack, QueryKind, RegionCuller, ZBuffer,
};

use super::candidate::Candidate;
use super::candidate::{PlannedCandidate, WithFront, WithScratch};
use super::plp::{Centroids, PlpCandidate};
use super::registry::Setting;
use super::registry::{Budgets, Entry};
use super::shop::{DELAUNAY, FINE_OCTREE, KD_TREE, OCTREE, PRISMS, Shop};

/// Pixels of the image that `region` draws, whatever the picture's resolution.
const REGION_PIXELS: u32 = 256 * 128;

/// What PLP may choose as occluders where nothing is asked for: about the visible set of `city`.
const OCCLUDER_BUDGET: &str = "4000";

/// Budgets where none is asked for: [`Budget::default`] for cPLP, the paper's largest for PLP alone.
const CPLP_BUDGET: &str = "100";
const PLP_BUDGET: &str = "10%";

/// Query back ends of cPLP; those that answer several cells at once can be asked in batches.
const CPLP_QUERIES: &[&str] =
    &["sampled", "item-buffer", "item-buffer-tiled", "histogram", "one-at-a-time", "per-fragment-histogram"];
const CPLP_QUERIES_BATCHED: [&str; 4] = ["per-fragment-histogram", "item-buffer", "item-buffer-tiled", "histogram"];

/// All of them, in the order in which they are told of.
pub(super) fn standard() -> Vec<Entry> {
    vec![
        Entry {
            name: "zbuffer",
            about: "everything, the baseline ZB",
            conservative: true,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::None,
            make: |shop, _| Box::new(WithScratch::new(ZBuffer::new(shop.scene()))),
        },
        Entry {
            name: "frustum-backface",
            about: "what is in view and not turned away, the baseline VF-BF",
            conservative: true,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::None,
            make: |shop, _| Box::new(WithScratch::new(FrustumBackface::new(shop.scene()))),
        },
        Entry {
            name: "frustum",
            about: "what is in view, by a kD-tree's nodes, objects and clusters: Coorg & Teller's baseline",
            conservative: true,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::None,
            make: |shop, _| {
                let rules = LargeOccluderRules::default().with_occluders(0);
                Box::new(WithScratch::new(LargeOccluder::new(shop.scene(), rules)))
            },
        },
        Entry {
            name: "large-occluder",
            about: "nodes of a kD-tree against planes of a few large polygons, kept from frame to frame (Coorg & Teller)",
            conservative: true,
            by_rays: false,
            tessellations: &[],
            queries: &["planes"],
            budget: Budgets::None,
            make: |shop, _| Box::new(WithScratch::new(LargeOccluder::build(shop.scene()))),
        },
        Entry {
            name: "planned",
            about: "everything, the frustum or `masked`, whichever pays: counted around the first eye and revised while it runs",
            conservative: true,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::None,
            make: |shop, _| Box::new(PlannedCandidate::new(shop.scene(), shop.switch())),
        },
        Entry {
            name: "masked",
            about: "conservative PLP against coverage masks: faces of cells are asked about, then objects and clusters",
            conservative: true,
            by_rays: false,
            tessellations: &[KD_TREE, OCTREE],
            queries: &["masks"],
            budget: Budgets::None,
            make: |shop, setting| {
                let tessellation = shop.tessellation(setting);
                Box::new(WithScratch::new(MaskedCplp::new(shop.scene(), tessellation)))
            },
        },
        Entry {
            name: "cplp",
            about: "conservative PLP: cells of a tessellation from the eye outward, queried against what was drawn",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: CPLP_QUERIES,
            budget: Budgets::Given(CPLP_BUDGET),
            make: |shop, setting| cplp(shop, setting, Occupancy::Off),
        },
        Entry {
            name: "cplp-occupancy",
            about: "the same, with a map of where was drawn that spares queries of cells that are certainly seen (Staneker)",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: CPLP_QUERIES,
            budget: Budgets::Given(CPLP_BUDGET),
            make: |shop, setting| cplp(shop, setting, Occupancy::Single),
        },
        Entry {
            name: "cplp-occupancy-always",
            about: "the same, where the map is asked to the end of a frame even if it spares little",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: CPLP_QUERIES,
            budget: Budgets::Given(CPLP_BUDGET),
            make: |shop, setting| cplp(shop, setting, Occupancy::Always),
        },
        Entry {
            name: "cplp-batches",
            about: "`cplp-occupancy` with four more maps that arrange what is left of a front into batches",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: &CPLP_QUERIES_BATCHED,
            budget: Budgets::Given(CPLP_BUDGET),
            make: |shop, setting| cplp(shop, setting, Occupancy::Batched),
        },
        Entry {
            name: "plp",
            about: "PLP within a budget by its default rule: cells by how much of them looks covered, not conservative",
            conservative: false,
            by_rays: false,
            tessellations: &[DELAUNAY, OCTREE, FINE_OCTREE, PRISMS],
            queries: &[],
            budget: Budgets::Any(PLP_BUDGET),
            make: |shop, setting| {
                let plan = shop.plan(setting);
                Box::new(PlpCandidate::new(shop.plp(setting, PlpRules::default()), plan))
            },
        },
        Entry {
            name: "plp-paper",
            about: "PLP within a budget by the paper's rule: solidity from counts of triangles, not conservative",
            conservative: false,
            by_rays: false,
            tessellations: &[DELAUNAY, OCTREE, FINE_OCTREE, PRISMS],
            queries: &[],
            budget: Budgets::Any(PLP_BUDGET),
            make: |shop, setting| {
                let plan = shop.plan(setting);
                Box::new(PlpCandidate::new(shop.plp(setting, PlpRules::paper()), plan))
            },
        },
        Entry {
            name: "centroid",
            about: "the nearest triangles of the scene up to a budget, then culled: PLP's baseline, not conservative",
            conservative: false,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::Visible(PLP_BUDGET),
            make: |shop, setting| Box::new(Centroids::new(shop.scene(), shop.plan(setting), false)),
        },
        Entry {
            name: "centroid-culled",
            about: "the same with culling first, so that only what is in view and not turned away counts",
            conservative: false,
            by_rays: false,
            tessellations: &[],
            queries: &[],
            budget: Budgets::Visible(PLP_BUDGET),
            make: |shop, setting| Box::new(Centroids::new(shop.scene(), shop.plan(setting), true)),
        },
        Entry {
            name: "query-front-to-back",
            about: "cells in view by distance, one query each: the paper's HP baseline",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: &["sampled"],
            budget: Budgets::None,
            make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Off),
        },
        Entry {
            name: "query-front-to-back-occupancy",
            about: "the same, with a map of where was drawn that spares queries of cells that are certainly seen (Staneker)",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: &["sampled"],
            budget: Budgets::None,
            make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Single),
        },
        Entry {
            name: "query-front-to-back-occupancy-always",
            about: "the same, where the map is asked to the end of a frame even if it spares little",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: &["sampled"],
            budget: Budgets::None,
            make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Always),
        },
        Entry {
            name: "query-front-to-back-batches",
            about: "`query-front-to-back-occupancy` with what is left asked in five batches after that, as four more maps arrange them",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE, KD_TREE, PRISMS],
            queries: &["sampled"],
            budget: Budgets::None,
            make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Batched),
        },
        Entry {
            name: "hierarchical-z",
            about: "an octree against a pyramid of farthest depths (Greene)",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE],
            queries: &["pyramid"],
            budget: Budgets::None,
            make: |shop, _| hierarchical_z(shop, Occupancy::Off),
        },
        Entry {
            name: "hierarchical-z-plp",
            about: "the same after drawing what PLP chooses within a budget as occluders",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE],
            queries: &["pyramid"],
            budget: Budgets::Given(OCCLUDER_BUDGET),
            make: |shop, setting| {
                let (octree, budget) = (shop.octree(), shop.budget(setting));
                // PLP walks the same cells: one octree is in memory.
                let plp = Plp::new(shop.scene(), PlpCells::Boxes(octree.clone()), PlpRules::default());
                let culler = HierarchicalZ::new(shop.scene(), octree).with_plp(Arc::new(plp), budget);
                Box::new(WithScratch::new(culler))
            },
        },
        Entry {
            name: "hierarchical-z-occupancy",
            about: "`hierarchical-z` with a map of where was drawn that is asked first",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE],
            queries: &["pyramid"],
            budget: Budgets::None,
            make: |shop, _| hierarchical_z(shop, Occupancy::Single),
        },
        Entry {
            name: "hierarchical-z-occupancy-always",
            about: "the same, where the map is asked to the end of a frame even if it spares little",
            conservative: true,
            by_rays: false,
            tessellations: &[OCTREE],
            queries: &["pyramid"],
            budget: Budgets::None,
            make: |shop, _| hierarchical_z(shop, Occupancy::Always),
        },
        Entry {
            name: "region",
            about: "for every eye of a ball and every resolution: under-estimating coverage with supporting planes",
            conservative: true,
            by_rays: true,
            tessellations: &[KD_TREE, OCTREE, PRISMS],
            queries: &["under"],
            budget: Budgets::None,
            make: |shop, setting| {
                let (cplp, occluders) = (shop.cplp(setting), shop.occluders());
                Box::new(WithScratch::new(RegionCuller::new(shop.scene(), cplp, occluders, REGION_PIXELS)))
            },
        },
    ]
}

/// cPLP with the query back end of a setting, with or without occupancy maps.
fn cplp(shop: &mut Shop, setting: &Setting, occupancy: Occupancy) -> Box<dyn Candidate> {
    let budget = Budget { triangles: shop.budget(setting) };
    let (scene, cplp) = (shop.scene(), shop.cplp(setting));
    match QueryKind::ALL.into_iter().find(|kind| Some(kind.name()) == setting.query) {
        Some(kind) => {
            let culler = CplpQueryCuller::new(scene.clone(), cplp.clone(), budget, kind).with_occupancy(occupancy);
            Box::new(WithFront::new(culler, scene, cplp, budget, kind))
        }
        None => {
            let culler = CplpCuller::new(scene.clone(), cplp.clone(), budget);
            let culler = culler.with_occupancy(occupancy);
            let query = QueryKind::PerFragmentHistogram;
            Box::new(WithFront::new(culler, scene, cplp, budget, query))
        }
    }
}

/// Greene's walk, with or without an occupancy map.
fn hierarchical_z(shop: &mut Shop, occupancy: Occupancy) -> Box<dyn Candidate> {
    let culler = HierarchicalZ::new(shop.scene(), shop.octree());
    Box::new(WithScratch::new(culler.with_occupancy(occupancy)))
}

/// One query a cell, with or without occupancy maps.
fn query_front_to_back(shop: &mut Shop, setting: &Setting, occupancy: Occupancy) -> Box<dyn Candidate> {
    let tessellation = shop.tessellation(setting);
    Box::new(WithScratch::new(QueryFrontToBack::new(shop.scene(), tessellation).with_occupancy(occupancy)))
}
