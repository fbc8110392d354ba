//! Whether a box may be seen: every way of asking says the same, in so many submissions, and says "seen" until it knows.

use std::sync::Arc;
use std::time::Duration;

use eyeline_client::gpu::{GpuQuery, GpuQueryKind, GpuStep};
use eyeline_visibility::{Aabb, PerFragmentHistogram, QueryBackEnd, Resolution};
use rand::{RngExt as _, SeedableRng as _};

use crate::{gpu_or_skip, made};

const RESOLUTION: Resolution = Resolution::new(150, 101);

/// The kinds that draw boxes.
const DRAWING: [GpuQueryKind; 6] = [
    GpuQueryKind::ItemBuffer,
    GpuQueryKind::ItemBufferTiled,
    GpuQueryKind::Histogram,
    GpuQueryKind::OcclusionQueries,
    GpuQueryKind::OneAtATime,
    GpuQueryKind::PerFragment,
];

#[test]
fn all_ways_give_the_answers_of_the_item_buffer() {
    let Some(gpu) = gpu_or_skip("all_ways_give_the_answers_of_the_item_buffer") else { return };
    let scene = made::rooms(1);
    let uploaded = made::uploaded(&gpu, &scene);
    let mut back_ends =
        GpuQueryKind::ALL.map(|kind| GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap());
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
    let (mut seen_total, mut hidden_total, mut by_pyramid, mut fewer) = (0, 0, 0, 0);
    for (number, view) in made::views(3, 16, RESOLUTION).into_iter().enumerate() {
        let boxes = made::boxes(&view, number as u64, 120);
        for back_end in &mut back_ends {
            back_end.begin(&view);
        }
        // First nothing is drawn, then more and more.
        for share in [0.0, 0.3, 1.0] {
            let drawn: Vec<u32> = made::all(&scene).into_iter().filter(|_| rng.random::<f64>() < share).collect();
            let answers = back_ends.each_mut().map(|back_end| {
                back_end.draw(&scene, &drawn);
                let mut seen = Vec::new();
                back_end.query(&boxes, &mut seen);
                back_end.check().unwrap();
                assert_eq!(seen.len(), boxes.len());
                seen
            });
            let drawing = GpuQueryKind::ALL.iter().zip(&answers).filter(|(kind, _)| DRAWING.contains(kind));
            assert_eq!(drawing.clone().count(), DRAWING.len());
            for (kind, answer) in drawing {
                assert!(*answer == answers[0], "{kind}: not the item buffer's answers in {view:?}");
            }
            // What is left out of a tiled one shows nothing.
            assert_eq!(back_ends[0].counts(), back_ends[6].counts());
            let items = answers[0].iter().zip(&answers[5]);
            assert!(items.clone().all(|(seen, pyramid)| *pyramid || !*seen), "the pyramid hid a seen box in {view:?}");
            by_pyramid += items.filter(|(seen, pyramid)| **pyramid && !**seen).count();
            // Counts of fragments are the same however they are counted, and a box is seen if it has one.
            let counts = [2, 4].map(|at| back_ends[at].counts().to_vec());
            assert_eq!(counts[0], counts[1]);
            assert_eq!(counts[0].iter().map(|count| *count > 0).collect::<Vec<_>>(), answers[0]);
            // Boxes of an item buffer cover each other.
            let uncovered = back_ends[0].counts();
            assert!(uncovered.iter().zip(&counts[0]).all(|(items, all)| items <= all));
            fewer += uncovered.iter().zip(&counts[0]).filter(|(items, all)| items < all).count();
            if share == 1.0 {
                seen_total += answers[0].iter().filter(|seen| **seen).count();
                hidden_total += answers[0].iter().filter(|seen| !**seen).count();
            }
        }
    }
    assert!(seen_total > 150 && hidden_total > 600, "{seen_total} {hidden_total}");
    assert!(fewer > 500 && by_pyramid > 10, "{fewer} {by_pyramid}");
    assert!(by_pyramid * 4 < hidden_total, "the pyramid hides next to nothing: {by_pyramid}");
}

#[test]
fn what_the_cpu_sees_is_seen() {
    let Some(gpu) = gpu_or_skip("what_the_cpu_sees_is_seen") else { return };
    let scene = made::rooms(4);
    let uploaded = made::uploaded(&gpu, &scene);
    let mut back_end = GpuQuery::new(Arc::clone(&gpu), uploaded, GpuQueryKind::PerFragment).unwrap();
    let mut on_cpu = PerFragmentHistogram::new();
    let (mut more, mut less, mut hidden, mut total) = (0, 0, 0, 0);
    for view in made::views(5, 24, RESOLUTION) {
        let boxes = made::boxes(&view, 6, 200);
        let (mut here, mut there) = (Vec::new(), Vec::new());
        back_end.begin(&view);
        on_cpu.begin(&view);
        back_end.draw(&scene, &made::all(&scene));
        on_cpu.draw(&scene, &made::all(&scene));
        back_end.query(&boxes, &mut here);
        on_cpu.query(&boxes, &mut there);
        more += here.iter().zip(&there).filter(|(here, there)| **here && !**there).count();
        less += here.iter().zip(&there).filter(|(here, there)| !**here && **there).count();
        hidden += here.iter().filter(|seen| !**seen).count();
        total += boxes.len();
    }
    // Boxes are larger here. What only the CPU sees would look through a pixel that a wall covers here alone.
    println!("{total} boxes, {hidden} hidden; only the adapter sees {more}, only the CPU {less}");
    assert_eq!(less, 0);
    assert!(more * 20 < hidden && hidden * 2 > total, "{more} of {hidden} of {total}");
}

#[test]
fn many_boxes_are_one_submission_and_layers_are_passes() {
    let Some(gpu) = gpu_or_skip("many_boxes_are_one_submission_and_layers_are_passes") else { return };
    let scene = made::rooms(7);
    let uploaded = made::uploaded(&gpu, &scene);
    let view = made::views(8, 1, RESOLUTION)[0];
    // More than a set of occlusion queries holds.
    let boxes = made::boxes(&view, 9, 5_000);
    let mut passes = Vec::new();
    for kind in DRAWING.into_iter().chain([GpuQueryKind::ZPyramid]) {
        // One at a time takes its time.
        let boxes: &[Aabb] = if kind == GpuQueryKind::OneAtATime { &boxes[..40] } else { &boxes };
        let mut back_end = GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
        back_end.begin(&view);
        back_end.draw(&scene, &made::all(&scene));
        let mut seen = Vec::new();
        let cost = back_end.query(boxes, &mut seen);
        back_end.check().unwrap();
        let stats = back_end.stats();
        assert_eq!(stats.submits, cost.passes as u64, "{kind}");
        assert_eq!(stats.unanswered, 0);
        assert!(stats.bytes >= 4 * cost.read_back, "{kind}: {stats:?} {cost:?}");
        passes.push((kind, cost.passes, stats.boxes));
    }
    let of = |kind| passes.iter().find(|row| row.0 == kind).map(|row| (row.1, row.2)).unwrap();
    for kind in [GpuQueryKind::OcclusionQueries, GpuQueryKind::PerFragment, GpuQueryKind::ZPyramid] {
        assert_eq!(of(kind).0, 1, "{kind}");
    }
    // Each pass of the others ends with one that shows nothing new.
    assert!(of(GpuQueryKind::ItemBuffer).0 > 2, "{passes:?}");
    assert_eq!(of(GpuQueryKind::ItemBuffer), of(GpuQueryKind::Histogram));
    assert_eq!(of(GpuQueryKind::ItemBuffer), of(GpuQueryKind::ItemBufferTiled));
    let (singles, drawn) = of(GpuQueryKind::OneAtATime);
    assert!(singles as u64 == drawn && singles > 5, "{passes:?}");
    assert!(of(GpuQueryKind::OcclusionQueries).1 > 1_000, "{passes:?}");
}

#[test]
fn what_is_not_answered_counts_as_visible() {
    let Some(gpu) = gpu_or_skip("what_is_not_answered_counts_as_visible") else { return };
    let scene = made::rooms(10);
    let uploaded = made::uploaded(&gpu, &scene);
    let view = made::views(11, 1, RESOLUTION)[0];
    let boxes = made::boxes(&view, 12, 100);
    for kind in GpuQueryKind::ALL {
        let mut back_end = GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
        back_end.begin(&view);
        back_end.draw(&scene, &made::all(&scene));
        // Nobody looked: what is not certainly out of view is visible.
        let mut unasked = Vec::new();
        back_end.submit(&boxes);
        back_end.take(&mut unasked);
        let in_view: Vec<bool> = boxes.iter().map(|aabb| back_end.in_view(aabb)).collect();
        assert_eq!(unasked, in_view, "{kind}");
        assert!(back_end.stats().unanswered > 10, "{kind}: {:?}", back_end.stats());
        // What was drawn then still counts, and the next query is answered in full.
        let mut polled = Vec::new();
        back_end.submit(&boxes);
        while !back_end.poll() {
            std::thread::yield_now();
        }
        back_end.take(&mut polled);
        let mut waited = Vec::new();
        let unanswered = back_end.stats().unanswered;
        back_end.query(&boxes, &mut waited);
        back_end.check().unwrap();
        assert_eq!(polled, waited, "{kind}");
        assert_eq!(back_end.stats().unanswered, unanswered);
        assert!(waited.iter().zip(&in_view).all(|(seen, in_view)| *in_view || !*seen));
        assert!(waited != in_view, "{kind} hides nothing");
        // Without patience an answer may come in time or not; none is wrong.
        let mut back_end = back_end.with_patience(Some(Duration::ZERO));
        let mut hasty = Vec::new();
        back_end.query(&boxes, &mut hasty);
        back_end.check().unwrap();
        assert!(hasty.iter().zip(&waited).all(|(hasty, seen)| *hasty || !*seen), "{kind}");
    }
}

#[test]
fn tiles_without_an_open_box_are_not_read_back() {
    let Some(gpu) = gpu_or_skip("tiles_without_an_open_box_are_not_read_back") else { return };
    let scene = made::rooms(13);
    let uploaded = made::uploaded(&gpu, &scene);
    let [mut whole, mut tiled] = [GpuQueryKind::ItemBuffer, GpuQueryKind::ItemBufferTiled]
        .map(|kind| GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap());
    // Three tiles by two, the right and lower ones cut off.
    let (width, height) = (150, 101);
    let mut seen = Vec::new();
    let mut finished_total = 0;
    for (number, view) in made::views(14, 8, Resolution::new(width, height)).into_iter().enumerate() {
        let boxes = made::boxes(&view, 60 + number as u64, 120);
        for back_end in [&mut whole, &mut tiled] {
            back_end.begin(&view);
            back_end.draw(&scene, &made::all(&scene));
        }
        let before = [&whole, &tiled].map(|back_end| back_end.stats().bytes);
        let costs = [&mut whole, &mut tiled].map(|back_end| back_end.query(&boxes, &mut seen));
        let bytes = [&whole, &tiled].map(|back_end| back_end.stats().bytes);
        assert_eq!(costs[0].passes, costs[1].passes);
        assert_eq!(costs[0].read_back, costs[0].passes as u64 * u64::from(width * height));
        // The first pass reads all, the later ones what showed something.
        assert!(
            costs[1].read_back <= costs[0].read_back && costs[1].read_back >= u64::from(width * height),
            "{costs:?}"
        );
        // What was read is what the adapter's rows are aligned to, and of that no more than the tiles.
        assert!(bytes[1] - before[1] >= 4 * costs[1].read_back, "{bytes:?} {costs:?}");
        assert!(tiled.finished_tiles().is_empty(), "only a whole front finishes tiles");

        // A front that is a few boxes: where none of them shows, nothing is asked again in this frame.
        let front: Vec<Aabb> = boxes.iter().filter(|aabb| tiled.in_view(aabb)).take(6).copied().collect();
        tiled.query_front(&front, &mut seen);
        let touching = (whole.query(&front, &mut Vec::new()), whole.counts().contains(&u32::MAX)).1;
        let finished = tiled.finished_tiles();
        assert!(!touching || finished.is_empty(), "a box at the near plane may be what any tile shows");
        finished_total += finished.len();
        let open = u64::from(width * height)
            - finished.iter().map(|tile| u64::from((tile.x[1] - tile.x[0]) * (tile.y[1] - tile.y[0]))).sum::<u64>();
        let first_pass = tiled.query_front(&front, &mut seen);
        assert!(first_pass.passes == 0 || first_pass.read_back >= open, "{first_pass:?}");
        assert!(first_pass.read_back <= first_pass.passes as u64 * open, "{first_pass:?} of {open}");
        assert_eq!(tiled.is_full(), open == 0);
        tiled.check().unwrap();
        // Other boxes are looked for everywhere.
        let (mut here, mut there) = (Vec::new(), Vec::new());
        whole.query(&boxes, &mut there);
        tiled.query(&boxes, &mut here);
        assert_eq!(here, there);
    }
    let [whole, tiled] = [whole.stats().bytes, tiled.stats().bytes];
    assert!(finished_total > 8 && tiled < whole, "{finished_total} tiles finished, {tiled} of {whole} bytes");
}

#[test]
fn a_query_step_by_step_tells_of_each_step_once() {
    let Some(gpu) = gpu_or_skip("a_query_step_by_step_tells_of_each_step_once") else { return };
    let scene = made::rooms(15);
    let uploaded = made::uploaded(&gpu, &scene);
    let view = made::views(16, 1, RESOLUTION)[0];
    let boxes = made::boxes(&view, 17, 60);
    for kind in GpuQueryKind::ALL {
        let mut back_end = GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
        back_end.begin(&view);
        back_end.draw(&scene, &made::all(&scene));
        let mut steps = Vec::new();
        let cost = back_end.step_by_step(&boxes, |step| steps.push(step)).unwrap();
        assert_eq!(steps, [GpuStep::Draw, GpuStep::Transfer, GpuStep::Scan], "{kind}");
        // The first pass of the query itself reads back as much.
        let read_back = match kind {
            GpuQueryKind::ItemBuffer | GpuQueryKind::ItemBufferTiled => RESOLUTION.pixels() as u64,
            _ => back_end.stats().boxes,
        };
        assert_eq!((cost.passes, cost.read_back), (1, read_back), "{kind}");
        // And it leaves no trace in later answers.
        let (mut after, mut fresh) = (Vec::new(), Vec::new());
        back_end.query(&boxes, &mut after);
        let mut other = GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
        other.begin(&view);
        other.draw(&scene, &made::all(&scene));
        other.query(&boxes, &mut fresh);
        assert_eq!(after, fresh, "{kind}");
        // Nothing to draw is an error, not a time.
        assert!(back_end.step_by_step(&[], |_| panic!("{kind} drew nothing")).is_err());
    }
}
