//! What cannot be done is said, and everything counts as visible meanwhile.

use std::sync::Arc;

use eyeline_client::gpu::{AdapterChoice, Gpu, GpuCuller, GpuError, GpuPicture, GpuQuery, GpuQueryKind, GpuScene};
use eyeline_visibility::{
    Aabb, Budget, Cplp, EyeRegion, Occupancy, OctreeRules, QueryBackEnd, Resolution, Scene, View,
};
use glam::DVec3;

use crate::{gpu_or_skip, made, or_skip};

fn culler(gpu: &Arc<Gpu>, scene: &Arc<Scene>, kind: GpuQueryKind) -> GpuCuller {
    let query = GpuQuery::new(Arc::clone(gpu), made::uploaded(gpu, scene), kind).unwrap();
    let cplp = Arc::new(Cplp::build(scene, OctreeRules::default()));
    GpuCuller::cplp(scene.clone(), cplp, Budget { triangles: 20 }, query, Occupancy::Off)
}

#[test]
fn a_device_that_is_gone_is_an_error() {
    let Some(gpu) = gpu_or_skip("a_device_that_is_gone_is_an_error") else { return };
    let scene = Arc::new(made::rooms(41));
    let view = made::views(42, 1, Resolution::new(64, 48))[0];
    let boxes = made::boxes(&view, 43, 50);
    let mut back_ends: Vec<GpuQuery> = GpuQueryKind::ALL
        .into_iter()
        .map(|kind| GpuQuery::new(Arc::clone(&gpu), made::uploaded(&gpu, &scene), kind).unwrap())
        .collect();
    let mut cullers = GpuQueryKind::ALL.map(|kind| culler(&gpu, &scene, kind));
    let mut picture = GpuPicture::new(Arc::clone(&gpu), made::uploaded(&gpu, &scene)).unwrap();
    for back_end in &mut back_ends {
        back_end.begin(&view);
        back_end.draw(&scene, &made::all(&scene));
        // One query is under way when it happens.
        back_end.submit(&boxes);
    }
    for culler in &mut cullers {
        culler.cull(&view, EyeRegion::point(view.eye)).unwrap();
    }
    gpu.device.destroy();
    for mut back_end in back_ends {
        let kind = back_end.kind();
        // Whatever came of the one under way, the next is not answered.
        back_end.poll();
        back_end.take(&mut Vec::new());
        let mut seen = Vec::new();
        back_end.query(&boxes, &mut seen);
        assert!(seen.iter().all(|seen| *seen), "{kind} hides by a device that is gone");
        let error = back_end.check().unwrap_err();
        assert!(matches!(error, GpuError::Lost { .. }), "{kind}: {error}");
        assert!(error.to_string().contains("lost"), "{error}");
        // And so on, without a panic.
        back_end.begin(&view);
        back_end.draw(&scene, &[0, 1]);
        back_end.query(&boxes, &mut seen);
        // What is out of view is known without a device.
        assert!(seen.iter().zip(&boxes).all(|(seen, aabb)| *seen || !back_end.in_view(aabb)), "{kind}");
        assert!(back_end.check().is_err());
    }
    for culler in &mut cullers {
        for _ in 0..2 {
            let error = culler.cull(&view, EyeRegion::point(view.eye)).unwrap_err();
            assert!(matches!(error, GpuError::Lost { .. }), "{error}");
        }
    }
    assert!(picture.winners(&view, &[0]).is_err());
    assert!(GpuScene::new(&gpu, &scene).is_err());
}

#[test]
fn what_is_larger_than_the_adapter_takes_is_an_error() {
    const TEST: &str = "what_is_larger_than_the_adapter_takes_is_an_error";
    let small = |limits: &mut wgpu::Limits| {
        limits.max_texture_dimension_2d = 256;
        limits.max_buffer_size = 256 << 10;
        limits.max_storage_buffer_binding_size = 128 << 10;
        limits.max_uniform_buffer_binding_size = 64 << 10;
    };
    let Some(gpu) = or_skip(TEST, Gpu::offscreen_within(AdapterChoice::Software, small)) else { return };
    let scene = Arc::new(made::rooms(44));
    let mut culler = culler(&gpu, &scene, GpuQueryKind::PerFragment);
    let mut view = made::views(45, 1, Resolution::new(300, 10))[0];
    let error = culler.cull(&view, EyeRegion::point(view.eye)).unwrap_err();
    assert!(matches!(error, GpuError::TooLarge { .. }), "{error}");
    for word in ["300x10 pixels", "max_texture_dimension_2d is 256", "take a smaller one"] {
        assert!(error.to_string().contains(word), "{error}");
    }
    // A smaller image is no trouble after that.
    view.resolution = Resolution::new(100, 60);
    assert!(!culler.cull(&view, EyeRegion::point(view.eye)).unwrap().visible.is_empty());
    // A scene of more than 256 KiB.
    let many = vec![scene.triangles()[0]; 8_000];
    let error = GpuScene::new(&gpu, &Scene::from_triangles(many)).unwrap_err();
    assert!(matches!(error, GpuError::TooLarge { .. }), "{error}");
    for word in ["triangles of 288000 bytes", "max_buffer_size is 262144 bytes", "smaller scene"] {
        assert!(error.to_string().contains(word), "{error}");
    }
    // Shaders are given less than a buffer may hold, and each use has the limit that it meets first.
    for (usage, bytes, limit) in [
        (wgpu::BufferUsages::STORAGE, 200 << 10, "max_storage_buffer_binding_size is 131072 bytes"),
        (wgpu::BufferUsages::UNIFORM, 100 << 10, "max_uniform_buffer_binding_size is 65536 bytes"),
    ] {
        let error = gpu.empty_buffer("answers", usage, bytes).unwrap_err().to_string();
        assert!(error.contains(limit) && error.contains("answers"), "{error}");
        gpu.empty_buffer("answers", wgpu::BufferUsages::VERTEX, bytes).unwrap();
    }
    gpu.check().unwrap();
}

#[test]
fn senseless_views_and_boxes_hide_nothing() {
    let Some(gpu) = gpu_or_skip("senseless_views_and_boxes_hide_nothing") else { return };
    let scene = Arc::new(made::rooms(46));
    let uploaded = made::uploaded(&gpu, &scene);
    let good = made::views(47, 1, Resolution::new(40, 30))[0];
    let nan = View { fov_x: f64::NAN, ..good };
    let nowhere = View { eye: DVec3::INFINITY, ..good };
    let odd = [
        Aabb::around(DVec3::NAN, DVec3::ONE),
        Aabb::around(DVec3::ZERO, DVec3::INFINITY),
        Aabb::around(DVec3::splat(1e300), DVec3::ONE),
        Aabb::around(good.eye, DVec3::ZERO),
    ];
    for kind in GpuQueryKind::ALL {
        let mut back_end = GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
        let mut seen = Vec::new();
        for view in [nan, nowhere] {
            back_end.begin(&view);
            back_end.draw(&scene, &made::all(&scene));
            back_end.query(&made::boxes(&good, 48, 20), &mut seen);
            assert_eq!(seen, [true; 20], "{kind}");
            assert!(!back_end.is_full());
        }
        back_end.begin(&View { resolution: Resolution::new(0, 9), ..good });
        assert!(back_end.is_full());
        back_end.query(&made::boxes(&good, 48, 20), &mut seen);
        assert!(seen.len() == 20);
        back_end.begin(&good);
        back_end.draw(&scene, &made::all(&scene));
        back_end.query(&odd, &mut seen);
        assert!(seen[0] && seen[1] && seen[3], "{kind}: {seen:?}");
        back_end.query(&[], &mut seen);
        assert!(seen.is_empty());
        back_end.check().unwrap();
        // One pixel, and a column of them.
        for resolution in [Resolution::new(1, 1), Resolution::new(1, 37)] {
            back_end.begin(&View { resolution, ..good });
            back_end.draw(&scene, &made::all(&scene));
            back_end.query(&made::boxes(&good, 49, 30), &mut seen);
            back_end.check().unwrap();
        }
        let mut culler = culler(&gpu, &scene, kind);
        let all = made::all(&scene);
        assert_eq!(culler.cull(&nan, EyeRegion::point(nan.eye)).unwrap().visible, all);
        assert_eq!(culler.cull(&good, EyeRegion { centre: good.eye, radius: 0.1 }).unwrap().visible, all);
    }
}

#[test]
fn an_empty_scene_shows_nothing() {
    let Some(gpu) = gpu_or_skip("an_empty_scene_shows_nothing") else { return };
    let scene = Arc::new(Scene::from_triangles(Vec::new()));
    let uploaded = made::uploaded(&gpu, &scene);
    assert!(uploaded.is_empty());
    let view = View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(16, 8));
    let mut picture = GpuPicture::new(Arc::clone(&gpu), uploaded).unwrap();
    assert_eq!(GpuPicture::owners(&picture.winners(&view, &[]).unwrap()), [0_u32; 0]);
    assert!(picture.winners(&View { near: -1.0, ..view }, &[]).unwrap().is_empty());
    for kind in GpuQueryKind::ALL {
        let culled = culler(&gpu, &scene, kind).cull(&view, EyeRegion::point(view.eye)).unwrap();
        assert!(culled.visible.is_empty());
    }
}
