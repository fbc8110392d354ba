//! What is wrong with settings that are each in their range: some contradict each other, some name files that are not what
//! they should be.

use std::path::Path;

use eyeline_protocol::WorldTime;

use super::Loaded;
use super::options::{ServeOptions, ServerOptions};
use crate::net::{Anonymous, Identity};
use crate::policy::PvsTable;

/// What is wrong between settings, by the key that is at fault: the key, and what is wrong with the remedy.
pub fn contradictions(options: &ServeOptions) -> Vec<(&'static str, String)> {
    let mut wrong = Vec::new();
    if options.policy == "pvs" && options.pvs.is_none() {
        let remedy = "name the table with --pvs or pvs = …; `eyeline-sim bake` makes one";
        wrong.push(("policy", format!("policy = 'pvs' needs a table: {remedy}")));
    }
    let tls = &options.tls;
    if tls.certificate.is_some() && tls.key.is_none() {
        let remedy = "name its private key with --tls-key, or tls.key = …";
        wrong.push(("tls.certificate", format!("tls.certificate stands alone: {remedy}")));
    }
    if tls.key.is_some() && tls.certificate.is_none() {
        let remedy = "name its certificate with --tls-certificate, or tls.certificate = …";
        wrong.push(("tls.key", format!("tls.key stands alone: {remedy}")));
    }
    if options.gate.anonymous == Anonymous::Never && options.gate.keys.is_empty() {
        let remedy = "make a key with `eyeline-server token key` and name it with --token-keys or gate.keys = …";
        wrong.push((
            "gate.anonymous",
            format!("gate.anonymous = 'never' and no gate.keys: nobody could come in; {remedy}"),
        ));
    }
    wrong
}

/// All that is wrong at `now` with settings and the files that they name, with the place of each. Reads the files and writes none.
pub fn problems(loaded: &Loaded<ServerOptions>, now: WorldTime) -> Vec<String> {
    let options = &loaded.options.serve;
    let at = |key: &str, reason: String| format!("{}: {reason}", loaded.origin(key));
    let mut problems: Vec<String> = contradictions(options).into_iter().map(|(key, reason)| at(key, reason)).collect();
    match &loaded.options.world {
        None => problems.push("world is not set; name the model to serve with world = … or --world".into()),
        Some(path) => {
            problems.extend(missing(path).map(|reason| at("world", format!("world = '{}': {reason}", path.display()))))
        }
    }
    if let Some(path) = &loaded.options.world_file {
        problems.extend(
            missing(path).map(|reason| at("world_file", format!("world_file = '{}': {reason}", path.display()))),
        );
    }
    if let Some(path) = options.pvs.as_ref().filter(|_| options.policy == "pvs") {
        problems.extend(PvsTable::read(path).err().map(|error| at("pvs", error.to_string())));
    }
    if let (Some(certificate), Some(key)) = (&options.tls.certificate, &options.tls.key) {
        match Identity::from_files(certificate, key) {
            Err(error) => problems.push(at("tls.certificate", error.to_string())),
            Ok(identity) => {
                let ended = identity.complaints(certificate, now).into_iter().filter(|complaint| complaint.is_now);
                problems.extend(ended.map(|complaint| at("tls.certificate", complaint.text)));
            }
        }
    }
    problems.extend(options.gate.gate().err().map(|error| at("gate.keys", error.to_string())));
    problems
}

/// What will be wrong before long: certificates that end soon.
pub fn warnings(loaded: &Loaded<ServerOptions>, now: WorldTime) -> Vec<String> {
    let tls = &loaded.options.serve.tls;
    let (Some(certificate), Some(key)) = (&tls.certificate, &tls.key) else { return Vec::new() };
    let Ok(identity) = Identity::from_files(certificate, key) else { return Vec::new() };
    let soon = identity.complaints(certificate, now).into_iter().filter(|complaint| !complaint.is_now);
    soon.map(|complaint| format!("{}: {}", loaded.origin("tls.certificate"), complaint.text)).collect()
}

fn missing(path: &Path) -> Option<String> {
    let error = std::fs::metadata(path).err()?;
    Some(format!("{error}; give the path of a file, as seen from the current folder"))
}
