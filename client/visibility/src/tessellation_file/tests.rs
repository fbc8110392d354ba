use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::CellId;
use crate::tessellation::laws::{poor_scenes, soup, triangle};

/// A storey of two rooms, so that there are prisms too.
fn rooms() -> Scene {
    let mut triangles = Vec::new();
    let mut quad = |[a, b, c, d]: [[f32; 3]; 4]| triangles.extend([triangle([a, b, c]), triangle([a, c, d])]);
    for y in [0.0, 3.0] {
        quad([[0.0, y, 0.0], [8.0, y, 0.0], [8.0, y, 4.0], [0.0, y, 4.0]]);
    }
    for x in [0.0, 4.0, 8.0] {
        quad([[x, 0.0, 0.0], [x, 0.0, 3.0], [x, 3.0, 3.0], [x, 3.0, 0.0]]);
    }
    for z in [0.0, 4.0] {
        quad([[0.0, 0.0, z], [8.0, 0.0, z], [8.0, 3.0, z], [0.0, 3.0, z]]);
    }
    Scene::from_triangles(triangles)
}

fn all(scene: &Scene) -> Vec<AnyTessellation> {
    AnyTessellation::NAMES.iter().filter_map(|name| AnyTessellation::build(name, scene).ok()).collect()
}

/// What PLP sees of cells.
fn seen(tessellation: &AnyTessellation) -> Vec<(Vec<u32>, Vec<DVec3>, Vec<CellId>)> {
    let cells = tessellation.plp_cells();
    let of = |cell| {
        let mut ways = Vec::new();
        cells.portals(cell, |portal| ways.push(portal.cell));
        (cells.primitives(cell).to_vec(), cells.corners(cell).to_vec(), ways)
    };
    (0..cells.len() as CellId).map(of).collect()
}

#[test]
fn what_was_written_is_read() {
    let mut scenes = poor_scenes();
    scenes.extend([soup(1, 200), rooms()]);
    let mut kinds = [0; 4];
    for scene in scenes {
        for made in all(&scene) {
            let read = AnyTessellation::from_bytes(&scene, &made.to_bytes(&scene)).unwrap();
            assert_eq!(seen(&read), seen(&made), "{}", made.name());
            assert_eq!((read.name(), read.memory_bytes()), (made.name(), made.memory_bytes()));
            assert_eq!(read.to_bytes(&scene), made.to_bytes(&scene));
            kinds[made.kind() as usize - 1] += 1;
            if let (Some(a), Some(b)) = (read.tessellation(), made.tessellation()) {
                let point = scene.bounds().centre();
                assert_eq!(a.cell_at(point), b.cell_at(point));
            }
        }
    }
    assert!(kinds.iter().all(|count| *count > 0), "{kinds:?}");
}

#[test]
fn files_cut_short_flipped_or_of_another_scene_are_refused() {
    let scene = rooms();
    let mut rng = Pcg64::seed_from_u64(71);
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        for length in (0..bytes.len()).step_by(1 + bytes.len() / 400) {
            assert!(AnyTessellation::from_bytes(&scene, &bytes[..length]).is_err(), "{length}");
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(matches!(AnyTessellation::from_bytes(&scene, &longer), Err(TessellationFault::Length { .. })));
        for _ in 0..300 {
            let mut flipped = bytes.clone();
            let at = rng.random_range(0..bytes.len());
            flipped[at] ^= 1 << rng.random_range(0..8);
            assert!(AnyTessellation::from_bytes(&scene, &flipped).is_err(), "{at}");
        }
        let mut moved = scene.triangles().to_vec();
        moved[3].corners[1].x += 1e-3;
        let other = AnyTessellation::from_bytes(&Scene::from_triangles(moved), &bytes);
        assert!(matches!(other, Err(TessellationFault::OtherScene { .. })));
    }
}

#[test]
fn bytes_that_were_made_up_are_refused_or_harmless() {
    let scene = rooms();
    let mut rng = Pcg64::seed_from_u64(72);
    let (mut refused, mut taken) = (0, 0);
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        for _ in 0..400 {
            let mut forged = bytes.clone();
            let end = forged.len() - CHECK_SUM_BYTES;
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(HEADER_BYTES..end);
                forged[at] = rng.random();
            }
            let sum = crc32fast::hash(&forged[..end]).to_le_bytes();
            forged[end..].copy_from_slice(&sum);
            match AnyTessellation::from_bytes(&scene, &forged) {
                Err(fault) => {
                    assert_eq!(fault, TessellationFault::Contradiction);
                    refused += 1;
                }
                Ok(read) => {
                    taken += 1;
                    seen(&read);
                }
            }
        }
    }
    assert!(refused > 200 && taken > 20, "{refused} refused, {taken} taken");
}

#[test]
fn a_refusal_names_file_and_remedy() {
    let scene = rooms();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rooms.tess");
    let missing = AnyTessellation::read(&scene, &path).unwrap_err().to_string();
    assert!(missing.contains("cannot read the tessellation") && missing.contains("rooms.tess"), "{missing}");
    let made = AnyTessellation::build("octree", &scene).unwrap();
    assert_eq!(made.write(&scene, &path).unwrap(), made.to_bytes(&scene).len() as u64);
    assert_eq!(seen(&AnyTessellation::read(&scene, &path).unwrap()), seen(&made));
    let other = AnyTessellation::read(&soup(1, 9), &path).unwrap_err().to_string();
    assert!(
        other.contains("rooms.tess was made for another scene") && other.contains("`eyeline-sim tessellate`"),
        "{other}"
    );
    let unknown = AnyTessellation::build("bsp", &scene).unwrap_err().to_string();
    assert!(unknown.contains("known: octree, kd-tree, delaunay, prisms"), "{unknown}");
}
