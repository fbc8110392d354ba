//! The layers of settings, as sources of the crate `config`: each value with where it was written.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;

use clap::Arg;
use config::{ConfigError, Map, Source, Value, ValueKind};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{Setting, is_list, short};

/// Variables of the environment begin so.
pub const PREFIX: &str = "EYELINE_";

/// Variables of that beginning which are others' business: the client's token, and what tests look at.
const OTHERS: [&str; 3] = ["EYELINE_TOKEN", "EYELINE_DATA", "EYELINE_SEEDS"];

/// Largest file of settings, bytes.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// What one layer says of one key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Given {
    /// Which, with its section: `gate.anonymous`.
    pub key: String,
    /// Where it was written.
    pub origin: String,
    /// What was written: one text, or those of a list.
    pub values: Vec<String>,
}

impl Given {
    pub(super) fn new(key: &Arg, origin: &str, values: impl IntoIterator<Item = String>) -> Given {
        Given { key: key.get_id().to_string(), origin: origin.to_owned(), values: values.into_iter().collect() }
    }
}

/// One layer.
#[derive(Clone, Debug, Default)]
pub struct Layer {
    given: BTreeMap<String, Given>,
}

impl Layer {
    pub(super) fn of(given: impl Iterator<Item = Given>) -> Layer {
        Layer { given: given.map(|given| (given.key.clone(), given)).collect() }
    }

    /// What it says.
    pub fn given(&self) -> impl Iterator<Item = &Given> {
        self.given.values()
    }
}

impl Source for Layer {
    fn clone_into_box(&self) -> Box<dyn Source + Send + Sync> {
        Box::new(self.clone())
    }

    fn collect(&self) -> Result<Map<String, Value>, ConfigError> {
        let value = |given: &Given| Value::new(Some(&given.origin), given.values.clone());
        Ok(self.given.values().map(|given| (given.key.clone(), value(given))).collect())
    }
}

/// What the layers together say of a key.
pub(super) fn lookup(merged: &Value, key: &str) -> Setting {
    let mut found = Some(merged);
    for part in key.split('.') {
        found = match found.map(|value| &value.kind) {
            Some(ValueKind::Table(table)) => table.get(part),
            _ => None,
        };
    }
    let origin = found.and_then(Value::origin).unwrap_or("default").to_owned();
    let values = found.and_then(|value| value.clone().into_array().ok()).unwrap_or_default();
    let values = values.into_iter().filter_map(|value| value.into_string().ok()).collect();
    Setting { key: key.to_owned(), values, origin }
}

/// What a file says of `keys`. What is wrong with it goes to `problems`.
pub(super) fn file(path: &Path, keys: &[&Arg], foreign: &[&str], problems: &mut Vec<String>) -> Layer {
    let name = path.display();
    let text = match read(path) {
        Ok(text) => text,
        Err(reason) => {
            problems.push(format!(
                "{name}: {reason}; name another with --config, or write one: eyeline-server config example > {name}"
            ));
            return Layer::default();
        }
    };
    let mut reader = Reader { name: &name.to_string(), text: &text, keys, foreign, problems, given: Vec::new() };
    match DeTable::parse(&text) {
        Ok(table) => reader.table("", table.get_ref()),
        Err(error) => {
            let place = reader.place(error.span().map_or(0, |span| span.start));
            let message = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
            reader.problems.push(format!("{place}: this is not TOML: {message}"));
        }
    }
    Layer::of(reader.given.into_iter())
}

fn read(path: &Path) -> Result<String, String> {
    let size = std::fs::metadata(path).map_err(|error| error.to_string())?.len();
    if size > FILE_BYTES_MAX {
        return Err(format!("{size} bytes are more than {FILE_BYTES_MAX}, too many for a file of settings"));
    }
    let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let line = 1 + error.as_bytes().iter().take(valid).filter(|&&byte| byte == b'\n').count();
        format!("line {line} is not UTF-8 text")
    })
}

/// Reads one file.
struct Reader<'a> {
    name: &'a str,
    text: &'a str,
    keys: &'a [&'a Arg],
    foreign: &'a [&'a str],
    problems: &'a mut Vec<String>,
    given: Vec<Given>,
}

impl Reader<'_> {
    fn place(&self, at: usize) -> String {
        let line = 1 + self.text.bytes().take(at).filter(|&byte| byte == b'\n').count();
        format!("{}:{line}", self.name)
    }

    /// A table: the whole file, or a section of it.
    fn table(&mut self, prefix: &str, table: &DeTable<'_>) {
        for (name, value) in table {
            let key = format!("{prefix}{}", name.get_ref());
            let place = self.place(name.span().start);
            if self.foreign.contains(&key.as_str()) {
                continue;
            }
            let section = format!("{key}.");
            let is_section = self.keys.iter().any(|known| known.get_id().as_str().starts_with(&section));
            let known = self.keys.iter().find(|known| known.get_id().as_str() == key).copied();
            match (known, value.get_ref()) {
                (_, DeValue::Table(table)) if is_section => self.table(&section, table),
                (Some(known), value) => match values(value, is_list(known)) {
                    Ok(values) => self.given.push(Given::new(known, &place, values)),
                    Err(remedy) => self.problems.push(format!("{place}: {key} is {}: {remedy}", value.type_str())),
                },
                (None, _) if is_section => {
                    self.problems.push(format!("{place}: {key} is a section: write [{key}], and its keys below"));
                }
                (None, _) => {
                    let remedy = remedy(&key, self.keys, str::to_owned);
                    self.problems.push(format!("{place}: there is no key '{}'; {remedy}", short(&key)));
                }
            }
        }
    }
}

/// The texts of a value.
fn values(value: &DeValue<'_>, is_list: bool) -> Result<Vec<String>, String> {
    let scalar = |value: &DeValue<'_>| match value {
        DeValue::String(text) => Some(text.to_string()),
        DeValue::Integer(number) => match i128::from_str_radix(number.as_str(), number.radix()) {
            Ok(number) => Some(number.to_string()),
            // Out of every range; its parser says which.
            Err(_) => Some(number.as_str().to_owned()),
        },
        DeValue::Float(number) => Some(number.as_str().to_owned()),
        DeValue::Boolean(value) => Some(value.to_string()),
        DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => None,
    };
    if let (true, DeValue::Array(items)) = (is_list, value) {
        let texts = items.iter().map(Spanned::get_ref).map(scalar).collect::<Option<Vec<_>>>();
        return texts.ok_or_else(|| "give a list of texts, as in [\"a\", \"b\"]".to_owned());
    }
    scalar(value).map(|text| vec![text]).ok_or_else(|| match is_list {
        true => "give a text, or a list of texts as in [\"a\", \"b\"]".to_owned(),
        false => "give one value, in quotes if it is a text".to_owned(),
    })
}

/// What the environment says of `keys`. An empty variable says nothing.
pub(super) fn environment(
    variables: impl IntoIterator<Item = (OsString, OsString)>,
    keys: &[&Arg],
    problems: &mut Vec<String>,
) -> Layer {
    let mut given = Vec::new();
    for (name, value) in variables {
        let Some(name) = name.to_str().filter(|name| name.starts_with(PREFIX)) else { continue };
        if OTHERS.contains(&name) || value.is_empty() {
            continue;
        }
        let Some(key) = keys.iter().find(|key| variable(key.get_id().as_str()) == name) else {
            let written = name.trim_start_matches(PREFIX).to_lowercase().replace("__", ".");
            let remedy = remedy(&written, keys, variable);
            problems.push(format!("environment: {} means nothing to the server; {remedy}, or unset it", short(name)));
            continue;
        };
        let Some(value) = value.to_str() else {
            problems.push(format!("{name}: its value is not UTF-8 text; use the file or --{}", flag(key)));
            continue;
        };
        let values: Vec<String> = match is_list(key) {
            true => value.split(',').map(|part| part.trim().to_owned()).collect(),
            false => vec![value.to_owned()],
        };
        given.push(Given::new(key, name, values));
    }
    // The environment has no order; messages should.
    problems.sort();
    Layer::of(given.into_iter())
}

/// The variable that sets a key: `EYELINE_GATE__ANONYMOUS` for `gate.anonymous`.
pub fn variable(key: &str) -> String {
    format!("{PREFIX}{}", key.to_uppercase().replace('.', "__"))
}

fn flag(key: &Arg) -> &str {
    key.get_long().unwrap_or_default()
}

/// The known key nearest to one that is not, by the whole or by its last part (then the section is wrong or missing).
fn remedy(written: &str, keys: &[&Arg], name: impl Fn(&str) -> String) -> String {
    let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
    let sections = keys.iter().filter_map(|key| key.get_id().as_str().split_once('.')).map(|(section, _)| section);
    let known = keys.iter().map(|key| key.get_id().as_str()).chain(sections);
    let likeness = |known: &str| {
        let parts = strsim::jaro_winkler(&last(written), &last(known)) * 0.99;
        strsim::jaro_winkler(written, known).max(parts)
    };
    let nearest = known.map(|known| (likeness(known), known)).max_by(|a, b| a.0.total_cmp(&b.0));
    match nearest {
        Some((likeness, known)) if likeness > 0.75 => format!("did you mean {}?", name(known)),
        _ => "`eyeline-server config example` lists them all".to_owned(),
    }
}
