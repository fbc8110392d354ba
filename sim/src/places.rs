//! `NAME.places.json`: where avatars may stand in a given scene (the file lies beside `NAME.glb`).
//!
//! ```json
//! {"unit": "metre", "position_is": "feet", "places": [{"kind": "spawn", "position": [53.0, 0.0, 45.5]}]}
//! ```
//! A place may have `min` and `max`, the room around it. Other fields are left alone.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;

/// Farthest coordinate that a place may have, in metres: the width of a world (DESIGN §6).
const FAR: f64 = 2e6;

/// A place where an avatar may stand.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// What the file says that it is: `spawn`, `item`, `room`; may be empty.
    pub kind: String,
    /// The feet, in metres.
    pub position: DVec3,
    /// Least and greatest corner of the room around it, if given.
    pub room: Option<(DVec3, DVec3)>,
}

/// Why a file of places cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlacesError {
    /// The file cannot be read.
    #[error("cannot read places from {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not JSON of the right shape.
    #[error("{path} is not a file of places: {source}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        source: serde_json::Error,
    },
    /// Its values cannot be used.
    #[error("{path}: {what}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Which value, and what would be right.
        what: String,
    },
}

#[derive(Deserialize)]
struct File {
    unit: Option<String>,
    position_is: Option<String>,
    places: Vec<Record>,
}

#[derive(Deserialize)]
struct Record {
    #[serde(default)]
    kind: String,
    position: [f64; 3],
    min: Option<[f64; 3]>,
    max: Option<[f64; 3]>,
}

/// Reads a file of places. There is at least one in the result.
pub fn read(path: &Path) -> Result<Vec<Place>, PlacesError> {
    match std::fs::read_to_string(path) {
        Ok(text) => parse(path, &text),
        Err(source) => Err(PlacesError::Read { path: path.into(), source }),
    }
}

/// The places beside a model (`oa_dm2.glb`, `oa_dm2.places.json`); `None` if there is no such file.
pub fn beside(model: &Path) -> Result<Option<Vec<Place>>, PlacesError> {
    match read(&model.with_extension("places.json")) {
        Err(PlacesError::Read { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
        result => result.map(Some),
    }
}

fn parse(path: &Path, text: &str) -> Result<Vec<Place>, PlacesError> {
    let file: File = serde_json::from_str(text).map_err(|source| PlacesError::Parse { path: path.into(), source })?;
    let bad = |what: String| Err(PlacesError::Value { path: path.into(), what });
    for (field, value, right) in
        [("unit", &file.unit, ["metre", "meter"]), ("position_is", &file.position_is, ["feet", "feet"])]
    {
        if let Some(value) = value.as_deref().filter(|value| !right.contains(value)) {
            return bad(format!("`{field}` is {value:?}, and only {:?} is understood; convert the places", right[0]));
        }
    }
    if file.places.is_empty() {
        return bad("`places` is empty; give at least one, or delete the file".into());
    }
    let mut places = Vec::with_capacity(file.places.len());
    for (number, Record { kind, position, min, max }) in file.places.into_iter().enumerate() {
        let values = [Some(position), min, max].into_iter().flatten().flatten();
        if let Some(value) = values.into_iter().find(|value| !(-FAR..=FAR).contains(value)) {
            return bad(format!("places[{number}] has a coordinate of {value}; give metres, at most {FAR}"));
        }
        let room = min.zip(max).map(|(min, max)| (DVec3::from(min), DVec3::from(max)));
        if room.is_some_and(|(min, max)| min.cmpgt(max).any()) {
            return bad(format!("places[{number}] has a `min` above its `max`; exchange them"));
        }
        places.push(Place { kind, position: position.into(), room });
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Vec<Place>, String> {
        parse(Path::new("hall.places.json"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn reads_places_with_and_without_rooms() {
        let places = parsed(
            r#"{"unit": "metre", "position_is": "feet", "by": "hand", "places": [
                {"kind": "spawn", "position": [1, 2.5, -3e1]},
                {"kind": "room", "position": [0, 0, 0], "min": [-1, 0, -1], "max": [1, 3, 1]}]}"#,
        );
        let places = places.unwrap();
        assert_eq!(places[0].position, DVec3::new(1.0, 2.5, -30.0));
        assert_eq!((places[0].kind.as_str(), places[0].room), ("spawn", None));
        assert_eq!(places[1].room, Some((DVec3::new(-1.0, 0.0, -1.0), DVec3::new(1.0, 3.0, 1.0))));
    }

    #[test]
    fn real_files_are_read() {
        let Some(folder) = crate::given_data("scenes") else { return };
        for (name, count) in [("oa_dm2", 44), ("oa_koth1", 98), ("ctf_compromise", 110), ("large_building", 8)] {
            let places = beside(&folder.join(name).with_extension("glb")).unwrap().unwrap();
            assert_eq!(places.len(), count, "{name}");
            assert_eq!(places.iter().filter(|place| place.room.is_some()).count(), if count == 8 { 8 } else { 0 });
        }
        assert!(beside(&folder.join("sponza.glb")).unwrap().is_none());
    }

    #[test]
    fn bad_files_are_named_with_place_and_remedy() {
        for (text, parts) in [
            ("{\"places\": [\n{\"position\": [1, 2]}]}", ["hall.places.json", "line 2"]),
            ("{\"places\": []}", ["hall.places.json", "empty"]),
            ("{\"unit\": \"foot\", \"places\": []}", ["`unit` is \"foot\"", "metre"]),
            ("{\"places\": [{\"position\": [0, 1e300, 0]}]}", ["places[0]", "at most"]),
            ("{\"places\": [{\"position\": [0, 1e999, 0]}]}", ["number out of range", "line 1"]),
            ("{\"places\": [{\"position\": [0,0,0], \"min\": [1,0,0], \"max\": [0,0,0]}]}", ["places[0]", "exchange"]),
            ("", ["not a file of places", "EOF"]),
        ] {
            let error = parsed(text).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        let missing = read(Path::new("no/such.places.json")).unwrap_err().to_string();
        assert!(missing.contains("no/such.places.json"));
        assert!(beside(Path::new("no/such.glb")).unwrap().is_none());
    }
}
