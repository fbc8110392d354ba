//! cPLP by rounds: how often a query is waited for, what PLP's budget saves, and what it costs (Klosowski & Silva 2001, §4).

mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Budget, Cplp, CplpScratch, Culler, EyeRegion, HierarchicalZ, ItemBufferQuery, OctreeRules, QueryBackEnd,
    QueryFrontToBack, QueryKind, Resolution, RoundsTraversal, Scratch, Traversal, View, exact_set,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// The rounds of some visitors of a building, per kind of back end.
fn rounds(kind: QueryKind, budget: Budget, side: u32) -> Vec<RoundsTraversal> {
    let mut rng = Pcg64::seed_from_u64(36);
    let scene = made::building(side, 10, 3);
    let cplp = Cplp::build(&scene, OctreeRules::default());
    let (mut back_end, mut scratch) = (kind.back_end(), CplpScratch::default());
    (0..10)
        .map(|_| {
            let view = made::visitor(&mut rng, side, Resolution::new(320, 240));
            cplp.traverse_rounds(&scene, &view, budget, &mut back_end, &mut scratch)
        })
        .collect()
}

#[test]
fn a_larger_budget_needs_fewer_rounds_and_a_per_fragment_histogram_one_pass_in_each() {
    let sum = |runs: &[RoundsTraversal], of: fn(&RoundsTraversal) -> usize| runs.iter().map(of).sum::<usize>();
    let mut before = usize::MAX;
    for triangles in [0, 200, 1000] {
        let budget = Budget { triangles };
        let single = rounds(QueryKind::PerFragmentHistogram, budget, 6);
        let items = rounds(QueryKind::ItemBuffer, budget, 6);
        let tiles = rounds(QueryKind::ItemBufferTiled, budget, 6);
        for ((single, items), tiles) in single.iter().zip(&items).zip(&tiles) {
            assert!(single.queries.passes <= single.traversal.rounds);
            assert!(single.queries.passes <= items.queries.passes);
            // The same questions and answers, in other passes; tiles only stop earlier.
            assert_eq!(
                single.traversal,
                Traversal {
                    passes: single.traversal.passes,
                    seen_z_tests: single.traversal.seen_z_tests,
                    read_back: single.traversal.read_back,
                    ..items.traversal
                }
            );
            assert_eq!([single, items].map(|run| run.traversal.passes), [single, items].map(|run| run.queries.passes));
            assert_eq!(items.traversal.triangles_drawn, tiles.traversal.triangles_drawn);
            assert!(tiles.traversal.rounds <= items.traversal.rounds);
            assert!(tiles.queries.read_back <= items.queries.read_back);
            assert_eq!(single.traversal.plp_triangles + single.extra_triangles(), single.traversal.triangles_drawn);
            assert!((0.0..=1.0).contains(&single.plp_share()));
        }
        let read_back = |run: &RoundsTraversal| run.queries.read_back as usize;
        let [tiled, whole] = [sum(&tiles, read_back), sum(&items, read_back)];
        assert!(tiled * 3 < whole * 2, "{tiled} of {whole} pixels read back");
        assert!(sum(&items, |run| run.queries.passes) * 2 > 3 * sum(&single, |run| run.queries.passes));
        let total = sum(&single, |run| run.traversal.rounds);
        assert!(total < before, "{total} rounds with a budget of {triangles}");
        before = total;
    }
}

#[test]
fn drawing_between_queries_draws_no_more() {
    let budget = Budget { triangles: 0 };
    let single = rounds(QueryKind::PerFragmentHistogram, budget, 6);
    let one = rounds(QueryKind::OneAtATime, budget, 6);
    for (single, one) in single.iter().zip(&one) {
        assert!(one.traversal.triangles_drawn <= single.traversal.triangles_drawn);
    }
    // A test ends with the first row that passes.
    let z_tests = |runs: &[RoundsTraversal]| runs.iter().map(|run| run.queries.z_tests).sum::<u64>();
    assert!(2 * z_tests(&one) < z_tests(&single), "{} of {}", z_tests(&one), z_tests(&single));
}

#[test]
fn watching_shows_each_front_and_its_answers() {
    let scene = made::building(3, 4, 3);
    let cplp = Cplp::build(&scene, OctreeRules::default().with_max_triangles_per_leaf(6));
    let view = View::level(DVec3::new(7.0, 1.6, 7.0), 0.3, 1.4, Resolution::new(128, 96));
    let mut back_end = ItemBufferQuery::new().with_tile_side(32);
    let (mut asked, mut seen, mut finished) = (0, 0, vec![0]);
    let budget = Budget { triangles: 0 };
    let done =
        cplp.watch_rounds(&scene, &view, budget, &mut back_end, &mut CplpScratch::default(), |round, back_end| {
            assert_eq!(round.number, finished.len());
            assert_eq!(round.cells.len(), round.seen.len());
            asked += round.cells.len();
            seen += round.seen.iter().filter(|&&seen| seen).count();
            finished.push(back_end.finished_tiles().len());
        });
    assert_eq!((asked, finished.len() - 1), (done.traversal.queries, done.traversal.rounds));
    assert_eq!(seen, done.traversal.cells_projected - done.plp_cells);
    // Tiles are finished for good, and in the end all are.
    assert!(finished.is_sorted());
    assert_eq!(finished.last(), Some(&12));
    assert!(back_end.is_full());
}

/// Prints the paper's Table 3 and what its Fig. 6 is about, for every back end:
/// `cargo test --release -p eyeline-visibility --test rounds -- --ignored --nocapture`.
#[test]
#[ignore = "prints a table"]
fn table_3() {
    let scene = Arc::new(made::building(16, 60, 1));
    let cplp = Cplp::build(&scene, OctreeRules::default());
    let resolution = Resolution::new(512, 512);
    let views: Vec<View> = {
        let mut rng = Pcg64::seed_from_u64(38);
        (0..40).map(|_| made::visitor(&mut rng, 16, resolution)).collect()
    };
    println!("{} triangles, {} cells, {resolution}", scene.triangles().len(), cplp.tessellation().cell_count());
    println!("back end, budget, rounds, passes, extra triangles, PLP share, z-tests per pixel, read back");
    let mean = |of: &dyn Fn(usize) -> f64| (0..views.len()).map(of).sum::<f64>() / views.len() as f64;
    for kind in QueryKind::ALL {
        for triangles in [0, 100, 300, 1000, 3000, 10_000] {
            let (mut back_end, mut scratch) = (kind.back_end(), CplpScratch::default());
            let runs: Vec<RoundsTraversal> = views
                .iter()
                .map(|view| cplp.traverse_rounds(&scene, view, Budget { triangles }, &mut back_end, &mut scratch))
                .collect();
            println!(
                "{kind}, {triangles}, {:.2}, {:.2}, {:.0}, {:.3}, {:.2}, {:.0}",
                mean(&|i| runs[i].traversal.rounds as f64),
                mean(&|i| runs[i].queries.passes as f64),
                mean(&|i| runs[i].extra_triangles() as f64),
                mean(&|i| runs[i].plp_share()),
                mean(&|i| runs[i].z_tests_per_pixel(resolution)),
                mean(&|i| runs[i].queries.read_back as f64),
            );
        }
    }
    let cullers: [(&str, Box<dyn Culler>); 2] = [
        ("front to back", Box::new(QueryFrontToBack::build(scene.clone()))),
        ("hierarchical Z", Box::new(HierarchicalZ::build(scene.clone()))),
    ];
    let mut scratch = Scratch::default();
    for (name, culler) in cullers {
        let runs: Vec<_> = views.iter().map(|v| culler.cull(v, EyeRegion::point(v.eye), &mut scratch)).collect();
        println!(
            "{name}: {:.0} triangles, {:.0} queries, {:.2} z-tests per pixel",
            mean(&|i| runs[i].visible.len() as f64),
            mean(&|i| runs[i].traversal.queries as f64),
            mean(&|i| runs[i].z_tests as f64 / resolution.pixels() as f64),
        );
    }
    let everything = mean(&|i| exact_set(&scene, &views[i]).1.z_tests() as f64 / resolution.pixels() as f64);
    println!("plain Z-buffer: {everything:.2} z-tests per pixel");
}
