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
fn files_cut_short_at_any_length_are_refused_by_name() {
    let scene = rooms();
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        for length in 0..bytes.len() {
            let fault = AnyTessellation::from_bytes(&scene, &bytes[..length]).unwrap_err();
            let (found, is_cut) = (length as u64, length >= MAGIC.len());
            let named = match fault {
                TessellationFault::NotATessellation => !is_cut,
                TessellationFault::Length { found: told, needed } => is_cut && told == found && needed > found,
                _ => false,
            };
            assert!(named, "{} at {length}: {fault}", made.name());
        }
        let mut longer = bytes.clone();
        longer.push(0);
        let fault = AnyTessellation::from_bytes(&scene, &longer).unwrap_err();
        assert_eq!(
            fault,
            TessellationFault::Length { found: longer.len() as u64, needed: bytes.len() as u64 },
            "{}",
            made.name()
        );
    }
}

#[test]
fn files_of_which_a_bit_flipped_are_refused_by_name() {
    let scene = rooms();
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        // Every bit of the header, and one of each of many bytes after it.
        let header = (0..HEADER_BYTES * 8).map(|bit| (bit / 8, bit % 8));
        let step = 1 + bytes.len() / 1_000;
        let after = (HEADER_BYTES..bytes.len()).step_by(step).map(|at| (at, at / step % 8));
        for (at, bit) in header.chain(after) {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1 << bit;
            let fault = AnyTessellation::from_bytes(&scene, &flipped).unwrap_err();
            let named = match at {
                0..8 => fault == TessellationFault::NotATessellation,
                8..12 => matches!(fault, TessellationFault::Version { found } if found != VERSION),
                32..40 => matches!(fault, TessellationFault::Length { .. }),
                // The kind, the scene's hash and all that follows are what the sum is of.
                _ => fault == TessellationFault::CheckSum,
            };
            assert!(named, "{} at {at}: {fault}", made.name());
        }
    }
}

#[test]
fn files_of_another_scene_are_refused_by_name() {
    let scene = rooms();
    let mut others: Vec<Scene> = poor_scenes();
    let mut moved = scene.triangles().to_vec();
    moved[3].corners[1].x += 1e-3;
    others.push(Scene::from_triangles(moved));
    let mut fewer = scene.triangles().to_vec();
    fewer.pop();
    others.push(Scene::from_triangles(fewer));
    let mut seen_through = scene.triangles().to_vec();
    seen_through[0].occludes = false;
    others.push(Scene::from_triangles(seen_through));
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        for other in &others {
            let fault = AnyTessellation::from_bytes(other, &bytes).unwrap_err();
            let (made_for, scene) = (scene_hash(&scene), scene_hash(other));
            assert_eq!(fault, TessellationFault::OtherScene { made_for, scene });
        }
    }
}

/// The same bytes with a header that fits them: length and check sum.
fn with_true_header(mut bytes: Vec<u8>) -> Vec<u8> {
    let body = (bytes.len() - HEADER_BYTES) as u64;
    bytes[HEADER_BYTES - 8..HEADER_BYTES].copy_from_slice(&body.to_le_bytes());
    let sum = crc32fast::hash(&bytes).to_le_bytes();
    bytes.extend(sum);
    bytes
}

#[test]
fn bodies_cut_short_under_a_true_header_are_refused_and_take_no_room() {
    let scene = rooms();
    for made in all(&scene) {
        let bytes = made.to_bytes(&scene);
        let body = bytes.len() - HEADER_BYTES - CHECK_SUM_BYTES;
        let step = 1 + body / 500;
        for length in (0..body).step_by(step).chain([body - 1]) {
            let cut = with_true_header(bytes[..HEADER_BYTES + length].to_vec());
            let fault = AnyTessellation::from_bytes(&scene, &cut).unwrap_err();
            assert_eq!(fault, TessellationFault::Contradiction, "{} at {length}", made.name());
        }
        // Another kind's body.
        for kind in 0..9_u32 {
            let mut other = bytes[..HEADER_BYTES + body].to_vec();
            other[12..16].copy_from_slice(&kind.to_le_bytes());
            let read = AnyTessellation::from_bytes(&scene, &with_true_header(other));
            assert_eq!(read.is_ok(), kind == made.kind(), "{} as {kind}", made.name());
        }
    }
    // Lists that claim to be longer than any memory reserve no more than there are bytes.
    for count in [u64::MAX, u64::MAX / 2, 1 << 40, 3] {
        let bytes = [&count.to_le_bytes()[..], &[1; 20]].concat();
        assert_eq!(Reader(&bytes).list(Reader::dvec3), None);
        assert_eq!(Reader(&bytes).list(Reader::u64), None);
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
