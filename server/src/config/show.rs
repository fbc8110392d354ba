//! Settings for people to read: what came out and whence, and an example of a file with all there is.

use std::fmt::Write as _;

use clap::{Arg, Args, Command};

use super::layers::variable;
use super::{Loaded, SECRETS, Setting, is_bare, is_list, keys};

/// Values for the keys that have no default, to show how one is written.
const SAMPLES: [(&str, &str); 14] = [
    ("world", "rooms.glb"),
    ("world_file", "rooms.world.toml"),
    ("pvs", "rooms.pvs"),
    ("seed", "7"),
    ("avatar_speed", "2"),
    ("dead_reckoning", "1"),
    ("bytes_per_second", "250000"),
    ("ready_file", "ready.txt"),
    ("tls.certificate", "fullchain.pem"),
    ("tls.key", "privkey.pem"),
    ("gate.keys", "eyeline-identity/tokens.pub"),
    ("gate.bans", "eyeline-identity/bans"),
    ("watch.metrics", "127.0.0.1:9464"),
    ("rooms", "10x10"),
];

/// Columns of a comment.
const WIDTH: usize = 100;

/// Each setting that is effective and where it comes from: a file of settings itself, but for secrets.
pub fn effective<T: Args>(loaded: &Loaded<T>) -> String {
    let command = super::command::<T>();
    let mut text = match &loaded.file {
        Some(file) => format!("# Settings from {}, the environment and flags\n", file.display()),
        None => "# Settings from the environment and flags; no file was read\n".to_owned(),
    };
    let mut section = None;
    for (key, setting) in keys(&command).zip(&loaded.settings) {
        enter(&mut text, &mut section, key, None);
        let name = last(&setting.key);
        let line = match setting {
            Setting { values, .. } if values.is_empty() => format!("#{name} is not set"),
            Setting { key, .. } if SECRETS.contains(&key.as_str()) => format!("#{name} is set, and secret"),
            Setting { values, .. } => format!("{name} = {}", toml_value(key, values)),
        };
        let _ = writeln!(text, "{line:<40} # {}", setting.origin);
    }
    text
}

/// A file with every key, its default and what it means. What has no default is commented out.
pub fn example<T: Args>() -> String {
    let command = super::command::<T>();
    let mut text = String::new();
    let preface = format!(
        "Settings of eyeline-server, which reads {} in its folder, or the file that --config names. The environment goes \
         before the file, flags go before both. Files are looked for from the folder in which the server is started. \
         `eyeline-server config check` says what is wrong, `eyeline-server config print` what is effective and why.",
        super::USUAL_FILE
    );
    comment(&mut text, &preface);
    let mut section = None;
    for key in keys(&command) {
        enter(&mut text, &mut section, key, Some(&command));
        let id = key.get_id().as_str();
        let help = key.get_long_help().or(key.get_help()).map(ToString::to_string).unwrap_or_default();
        let _ = writeln!(text);
        comment(&mut text, &help);
        let names: Vec<String> = key.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect();
        if !names.is_empty() && !key.is_hide_possible_values_set() {
            comment(&mut text, &format!("One of: {}", names.join(", ")));
        }
        comment(&mut text, &format!("--{}, {}", key.get_long().unwrap_or_default(), variable(id)));
        let defaults: Vec<String> =
            key.get_default_values().iter().map(|value| value.to_string_lossy().into_owned()).collect();
        let name = last(id);
        let _ = match defaults.is_empty() {
            false => writeln!(text, "{name} = {}", toml_value(key, &defaults)),
            true => writeln!(text, "#{name} = {}", toml_value(key, &[sample(id).to_owned()])),
        };
    }
    text
}

fn sample(key: &str) -> &'static str {
    SAMPLES.iter().find(|(known, _)| *known == key).map_or("", |(_, sample)| sample)
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or_default()
}

/// Begins the section of a key, unless it has begun.
fn enter<'a>(text: &mut String, section: &mut Option<&'a str>, key: &'a Arg, command: Option<&Command>) {
    let is_in = key.get_id().as_str().split_once('.').map(|(section, _)| section);
    if is_in == *section {
        return;
    }
    *section = is_in;
    let _ = writeln!(text);
    if let (Some(heading), Some(_)) = (key.get_help_heading(), command) {
        comment(text, heading);
    }
    let _ = writeln!(text, "[{}]", is_in.unwrap_or_default());
}

fn comment(text: &mut String, words: &str) {
    let mut line = "#".to_owned();
    for word in words.split_whitespace() {
        if line.len() + 1 + word.len() > WIDTH {
            let _ = writeln!(text, "{line}");
            line = "#".to_owned();
        }
        line += " ";
        line += word;
    }
    let _ = writeln!(text, "{line}");
}

/// Some values as the file has them.
fn toml_value(key: &Arg, values: &[String]) -> String {
    let one = |value: &String| {
        let is_bare = is_bare(key.get_value_parser()) && toml::de::DeValue::parse(value).is_ok();
        if is_bare { value.clone() } else { toml::Value::String(value.clone()).to_string() }
    };
    match values {
        [value] if !is_list(key) => one(value),
        _ => format!("[{}]", values.iter().map(one).collect::<Vec<_>>().join(", ")),
    }
}
