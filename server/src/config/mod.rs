//! Where do a server's settings come from, and is each of them known and in its range?
//!
//! Four layers, each over the one before: defaults, one TOML file, the environment (`EYELINE_TICK_HZ`, and
//! `EYELINE_GATE__ANONYMOUS` for a key in a section), flags. What can be set is what has a flag: the declarations in
//! [`options`] are also the keys of the file and the names in the environment, so that a range, a default or a word of help
//! is written once. Values stay text until the flag's own parser reads them, wherever they come from.
//!
//! The crate `config` lays the layers over each other; [`layers`] are its sources, which know line and variable of each
//! value, and [`show`] says what came of it.

pub mod check;
pub mod layers;
pub mod options;
pub mod show;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use clap::builder::ValueParser;
use clap::error::{ContextKind, ContextValue};
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use layers::{Given, Layer};

/// The file that is read if none is named and it is there.
pub const USUAL_FILE: &str = "eyeline-server.toml";

/// What must not be shown to who only looks at settings. Who knows the seed of the secret grid knows where hidden things
/// are.
const SECRETS: [&str; 1] = ["seed"];

/// Something is wrong with the settings.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", one_line(.problems))]
pub struct ConfigError {
    /// Each names a value, its place and the remedy. Never empty.
    pub problems: Vec<String>,
}

fn one_line(problems: &[String]) -> String {
    let first = problems.first().map_or("the settings are wrong", |first| first);
    match problems.len() {
        0 | 1 => first.to_owned(),
        n => format!("{first} (and {} more: see `eyeline-server config check`)", n - 1),
    }
}

/// The settings that are flags of `T`, as far as the command line gave them. Has the flags of `T` itself, so that it takes
/// the place of `T` where the file and the environment count too.
#[derive(Clone, Debug)]
pub struct Flags<T> {
    given: BTreeMap<String, Vec<OsString>>,
    of: PhantomData<T>,
}

impl<T: Args> FromArgMatches for Flags<T> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Flags<T>, clap::Error> {
        let mut given = BTreeMap::new();
        for arg in command::<T>().get_arguments() {
            let id = arg.get_id().as_str();
            // A default is no choice: it must not win over the file.
            if matches.value_source(id) == Some(ValueSource::CommandLine) {
                given.insert(id.to_owned(), matches.get_raw(id).into_iter().flatten().map(Into::into).collect());
            }
        }
        Ok(Flags { given, of: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.given.extend(Flags::<T>::from_arg_matches(matches)?.given);
        Ok(())
    }
}

impl<T: Args> Args for Flags<T> {
    fn group_id() -> Option<clap::Id> {
        T::group_id()
    }

    fn augment_args(command: Command) -> Command {
        T::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        T::augment_args_for_update(command)
    }
}

/// One setting as it came out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its key: `tick_hz`, or `gate.anonymous` in a section.
    pub key: String,
    /// What it is, as it was written; nothing if it is not set.
    pub values: Vec<String>,
    /// Where that was: `default`, a file and its line, a variable of the environment or a flag.
    pub origin: String,
}

/// What the server runs with.
#[derive(Clone, Debug)]
pub struct Loaded<T> {
    /// The settings.
    pub options: T,
    /// Where each of them comes from, in the order of the flags.
    pub settings: Vec<Setting>,
    /// The file that was read.
    pub file: Option<PathBuf>,
}

impl<T> Loaded<T> {
    /// Where the value of a key comes from, for messages.
    pub fn origin(&self, key: &str) -> &str {
        self.settings.iter().find(|setting| setting.key == key).map_or("default", |setting| &setting.origin)
    }
}

impl<T: Args> Flags<T> {
    /// No flag at all.
    pub fn none() -> Flags<T> {
        Flags { given: BTreeMap::new(), of: PhantomData }
    }

    /// Reads this file, whatever the flags say.
    pub fn with_file(mut self, file: &Path) -> Flags<T> {
        self.given.insert("config".into(), vec![file.as_os_str().to_owned()]);
        self
    }

    /// Lays the flags over the environment of this process, and that over the file. `foreign` are keys of the file that
    /// mean something to another program which reads it too.
    ///
    /// # Errors
    /// Names every value that is wrong, its place and the remedy.
    pub fn load(&self, foreign: &[&str]) -> Result<Loaded<T>, ConfigError> {
        self.load_from(std::env::vars_os(), foreign)
    }

    /// [`Flags::load`] with another environment.
    ///
    /// # Errors
    /// Names every value that is wrong, its place and the remedy.
    pub fn load_from(
        &self,
        environment: impl IntoIterator<Item = (OsString, OsString)>,
        foreign: &[&str],
    ) -> Result<Loaded<T>, ConfigError> {
        let command = command::<T>();
        let keys: Vec<&Arg> = keys(&command).collect();
        let mut problems = Vec::new();

        let named = self.given.get("config").and_then(|values| values.first()).map(PathBuf::from);
        let usual = || Some(PathBuf::from(USUAL_FILE)).filter(|path| path.exists());
        let file = named.or_else(usual);
        let written = file.as_deref().map(|path| layers::file(path, &keys, foreign, &mut problems));
        let environment = layers::environment(environment, &keys, &mut problems);
        let defaults = keys.iter().filter(|key| !key.get_default_values().is_empty());
        let text = |value: &clap::builder::OsStr| value.to_string_lossy().into_owned();
        let defaults = defaults.map(|key| Given::new(key, "default", key.get_default_values().iter().map(text)));
        let flags = keys.iter().filter_map(|key| {
            let values = self.given.get(key.get_id().as_str())?;
            let origin = format!("--{}", key.get_long().unwrap_or_default());
            Some(Given::new(key, &origin, values.iter().map(|value| value.to_string_lossy().into_owned())))
        });

        let mut builder = config::Config::builder().add_source(Layer::of(defaults));
        for layer in [written.unwrap_or_default(), environment] {
            layer.given().for_each(|given| check(&command, given, &mut problems));
            builder = builder.add_source(layer);
        }
        if !problems.is_empty() {
            return Err(ConfigError { problems });
        }
        let broken = |error: &dyn std::fmt::Display| ConfigError { problems: vec![error.to_string()] };
        let merged = builder.add_source(Layer::of(flags)).build().map_err(|error| broken(&error))?;

        let mut settings = Vec::new();
        let mut effective = command.clone().no_binary_name(true);
        for key in &keys {
            let id = key.get_id().as_str();
            let setting = layers::lookup(&merged.cache, id);
            // A flag's path need not be text.
            let raw = self.given.get(id).cloned();
            let raw = raw.unwrap_or_else(|| setting.values.iter().map(Into::into).collect());
            if !raw.is_empty() {
                effective = effective.mut_arg(id, |arg| arg.default_values(raw.clone()));
            }
            settings.push(setting);
        }
        let matches = effective.try_get_matches_from(std::iter::empty::<OsString>()).map_err(|error| broken(&error))?;
        let options = T::from_arg_matches(&matches).map_err(|error| broken(&error))?;
        Ok(Loaded { options, settings, file })
    }
}

/// The flags of `T` alone.
fn command<T: Args>() -> Command {
    T::augment_args(Command::new("settings"))
}

/// The flags that are settings: all but the one that names the file.
fn keys(command: &Command) -> impl Iterator<Item = &Arg> {
    command.get_arguments().filter(|arg| arg.get_id() != "config" && arg.get_long().is_some())
}

/// Whether a key takes a list.
fn is_list(key: &Arg) -> bool {
    matches!(key.get_action(), ArgAction::Append)
}

/// Whether a key's values are written without quotes.
fn is_bare(parser: &ValueParser) -> bool {
    use std::any::TypeId;
    let bare =
        [TypeId::of::<f64>(), TypeId::of::<u64>(), TypeId::of::<u32>(), TypeId::of::<u16>(), TypeId::of::<bool>()];
    bare.iter().any(|bare| parser.type_id() == *bare)
}

/// Lets the flag's own parser read what another layer gave.
fn check(command: &Command, given: &Given, problems: &mut Vec<String>) {
    let Some(key) = keys(command).find(|key| key.get_id().as_str() == given.key) else { return };
    for value in &given.values {
        let argument = format!("--{}={value}", key.get_long().unwrap_or_default());
        let parsed = command.clone().no_binary_name(true).try_get_matches_from([argument]);
        if let Some(reason) = parsed.err().and_then(|error| reason(&error)) {
            let shown = if SECRETS.contains(&given.key.as_str()) { "…".into() } else { short(value) };
            problems.push(format!("{}: {} = '{shown}': {reason}", given.origin, given.key));
        }
    }
}

/// Why a value is refused, if it is for its own sake and not for the lack of another.
fn reason(error: &clap::Error) -> Option<String> {
    use clap::error::ErrorKind;
    match error.kind() {
        ErrorKind::ValueValidation => {
            use std::error::Error as _;
            Some(error.source().map_or_else(|| "it is not a value for this key".into(), ToString::to_string))
        }
        ErrorKind::InvalidValue => match error.get(ContextKind::ValidValue) {
            Some(ContextValue::Strings(valid)) if !valid.is_empty() => {
                Some(format!("give one of {}", valid.join(", ")))
            }
            _ => Some("it is empty; give a value, or leave the key out".into()),
        },
        _ => None,
    }
}

/// A value for a message: what is long is cut off.
fn short(value: &str) -> String {
    let is_long = value.chars().count() > 80;
    if is_long { value.chars().take(80).chain("…".chars()).collect() } else { value.to_owned() }
}
