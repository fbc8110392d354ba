//! The static scene as a client makes it: from the model's bytes and what the server said of them.
//!
//! A model alone does not say which of its nodes move (a `world.toml` at the server may), nor whether faces count
//! two-sided. The welcome and the roster do, so that both ends cull against the same triangles.

use std::collections::BTreeSet;

use eyeline_protocol::Welcome;
use eyeline_visibility::{LoadError, LoadOptions, Scene, load_glb};
use glam::DVec3;

/// Why a client has no scene.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The model can't be loaded, or lacks a node that the server says moves.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// Loaded here, the model has another anchor than at the server, so no position would fit.
    #[error("{file}: its anchor is {found} here but {told} at the server; both must be of one version of Eyeline")]
    Anchor {
        /// The file.
        file: String,
        /// Ours.
        found: DVec3,
        /// The server's.
        told: DVec3,
    },
}

/// The scene of a model: `bytes` of a .glb, what the server's `welcome` says of it, and the names of the nodes that
/// move ([`crate::session::Session::moving_nodes`]). `name` stands for the file in errors.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn load(bytes: &[u8], name: &str, welcome: &Welcome, moving_nodes: &BTreeSet<String>) -> Result<Scene, WorldError> {
    let scene = load_glb(bytes, name, &options(welcome, moving_nodes))?;
    check_anchor(&scene, name, welcome)?;
    Ok(scene)
}

/// How to load a server's model.
pub fn options(welcome: &Welcome, moving_nodes: &BTreeSet<String>) -> LoadOptions {
    LoadOptions::default().with_moving_nodes(moving_nodes).with_two_sided(welcome.world.two_sided)
}

/// Refuses a scene whose positions would not fit what the server says.
///
/// # Errors
/// Names the file and both anchors.
pub fn check_anchor(scene: &Scene, name: &str, welcome: &Welcome) -> Result<(), WorldError> {
    let told = DVec3::from_array(welcome.anchor);
    if scene.anchor() != told {
        return Err(WorldError::Anchor { file: name.to_owned(), found: scene.anchor(), told });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use eyeline_protocol::{
        ClassId, ClientId, Issue, ObjectId, RosterEntry, ServerControl, VERSION, WorldInfo, WorldTime, codec,
    };
    use eyeline_visibility::{Aabb, DynamicOctree};

    use super::*;
    use crate::session::{Session, SessionConfig};

    fn welcome(objects: u32, anchor: [f64; 3]) -> Welcome {
        Welcome {
            version: VERSION,
            client: ClientId(1),
            avatars: Vec::new(),
            anchor,
            tick_micros: 50_000,
            policy: "visible".into(),
            tracking: true,
            blur: 1.0,
            dead_reckoning_px: None,
            world: WorldInfo { name: "w".into(), hash: [0; 32], size_bytes: 0, two_sided: false },
            classes: Vec::new(),
            objects,
            rank: eyeline_protocol::Rank::Actor,
            resume: [0; 16],
            answer_micros: 0,
            grace_millis: 0,
            continuity: eyeline_protocol::Continuity::New,
        }
    }

    /// A model of two nodes without meshes.
    fn model() -> Vec<u8> {
        let mut json = br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1]}],
            "nodes":[{"name":"chair"},{"name":"table"}]}"#
            .to_vec();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((20 + json.len() as u32).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json);
        glb
    }

    #[test]
    fn what_moves_is_known_once_the_roster_is_whole() {
        let mut session =
            Session::new(SessionConfig::default(), Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let mut hear = |message: ServerControl| {
            session.handle_control(&codec::encode_control(&message)[4..]);
            session.moving_nodes().map(|nodes| nodes.iter().cloned().collect::<Vec<_>>())
        };
        let roster = |object, node: &str| ServerControl::Roster {
            tick: WorldTime::ZERO,
            entries: vec![RosterEntry {
                object: ObjectId(object),
                class: ClassId(0),
                name: String::new(),
                node: node.into(),
                bound: None,
                issue: Issue(0),
                present: true,
            }],
        };
        assert_eq!(hear(ServerControl::Welcome(Box::new(welcome(3, [0.0; 3])))), None);
        assert_eq!(hear(roster(0, "chair")), None);
        assert_eq!(hear(roster(1, "")), None);
        assert_eq!(hear(roster(2, "chair")), Some(vec!["chair".to_owned()]));
        // An avatar that comes later changes nothing.
        assert_eq!(hear(roster(3, "door")), Some(vec!["chair".to_owned()]));
    }

    #[test]
    fn a_scene_must_fit_what_the_server_says() {
        let nodes = |name: &str| BTreeSet::from([name.to_owned()]);
        let scene = load(&model(), "w.glb", &welcome(1, [0.0; 3]), &nodes("chair")).unwrap();
        assert_eq!(scene.objects().len(), 1);
        let error = load(&model(), "w.glb", &welcome(1, [0.0; 3]), &nodes("stool")).unwrap_err().to_string();
        assert!(error.contains("w.glb") && error.contains("stool"), "{error}");
        let error = load(&model(), "w.glb", &welcome(1, [5.0, 0.0, 0.0]), &nodes("chair")).unwrap_err().to_string();
        assert!(error.contains("w.glb") && error.contains("anchor"), "{error}");
    }
}
