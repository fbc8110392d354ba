//! Tests of the layers together: precedence, origins, what is refused, and that the example can't go stale.

use std::path::PathBuf;

use clap::{FromArgMatches, Parser};
use tempfile::TempDir;

use super::options::ServerOptions;
use super::*;

/// The flags that a command line means.
fn flags(args: &[&str]) -> Flags<ServerOptions> {
    let command = Flags::<ServerOptions>::augment_args(Command::new("server").no_binary_name(true));
    Flags::from_arg_matches(&command.try_get_matches_from(args).unwrap()).unwrap()
}

fn variables(variables: &[(&str, &str)]) -> Vec<(OsString, OsString)> {
    variables.iter().map(|(name, value)| (name.into(), value.into())).collect()
}

/// A file of settings in a folder of its own.
fn file(text: &str) -> (TempDir, PathBuf) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.toml");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

fn load(args: &[&str], text: &str, env: &[(&str, &str)]) -> Result<Loaded<ServerOptions>, Vec<String>> {
    let (_folder, path) = file(text);
    let loaded = flags(args).with_file(&path).load_from(variables(env), &[]);
    let shorter = |problem: String| problem.replace(&path.display().to_string(), "s.toml");
    loaded.map_err(|error| error.problems.into_iter().map(shorter).collect())
}

#[test]
fn a_flag_wins_over_the_environment_that_over_the_file_and_that_over_defaults() {
    let text = "tick_hz = 1\nblur = 2\nradius = 3\n[gate]\nanonymous = 'never'\nkeys = ['a', 'b']\n";
    let env = [("EYELINE_TICK_HZ", "10"), ("EYELINE_BLUR", "20 m"), ("EYELINE_GATE__ANONYMOUS", "anywhere")];
    let loaded = load(&["--tick-hz", "100"], text, &env).unwrap();
    let serve = &loaded.options.serve;
    assert_eq!((serve.tick_hz, serve.blur, serve.radius, serve.cell), (100.0, 20.0, 3.0, 30.0));
    assert_eq!(serve.gate.anonymous, crate::net::Anonymous::Anywhere);
    assert_eq!(serve.gate.keys, [PathBuf::from("a"), PathBuf::from("b")]);
    let origin = |key: &str| loaded.origin(key).rsplit('/').next().unwrap().to_owned();
    assert_eq!(
        ["tick_hz", "blur", "radius", "cell", "gate.anonymous", "gate.keys"].map(origin),
        ["--tick-hz", "EYELINE_BLUR", "s.toml:3", "default", "EYELINE_GATE__ANONYMOUS", "s.toml:6"]
    );
}

#[test]
fn a_flag_that_was_not_given_is_not_one_though_it_has_a_default() {
    assert_eq!(load(&[], "tick_hz = 5", &[]).unwrap().options.serve.tick_hz, 5.0);
    // The default itself, if it is given, is a choice.
    assert_eq!(load(&["--tick-hz", "20"], "tick_hz = 5", &[]).unwrap().options.serve.tick_hz, 20.0);
    assert!(load(&["--audit"], "", &[]).unwrap().options.serve.audit);
    assert!(!load(&["--audit=false"], "audit = true", &[]).unwrap().options.serve.audit);
    // An empty variable says nothing, and others' variables are theirs.
    let env = [("EYELINE_TICK_HZ", ""), ("EYELINE_TOKEN", "v4"), ("OTHER", "x")];
    assert_eq!(load(&[], "", &env).unwrap().options.serve.tick_hz, 20.0);
    let env = [("EYELINE_GATE__KEYS", "a.pub, b.pub")];
    let keys = load(&[], "", &env).unwrap().options.serve.gate.keys;
    assert_eq!(keys, [PathBuf::from("a.pub"), PathBuf::from("b.pub")]);
}

#[test]
fn defaults_are_those_of_the_flags() {
    #[derive(Parser)]
    struct Plain {
        #[command(flatten)]
        server: ServerOptions,
    }
    let plain = Plain::try_parse_from(["server"]).unwrap().server;
    let loaded = load(&[], "", &[]).unwrap();
    assert_eq!(format!("{plain:?}").replace("config: None", ""), {
        let options = format!("{:?}", loaded.options);
        options.replace("config: None", "")
    });
    assert!(loaded.settings.iter().all(|setting| setting.origin == "default"));
}

/// All that can be wrong with the layers. The first text is the file, the second what is said.
const WRONG: [(&str, &str); 24] = [
    ("tikc_hz = 1", "s.toml:1: there is no key 'tikc_hz'; did you mean tick_hz?"),
    ("\n\ncertificate = 'a'", "s.toml:3: there is no key 'certificate'; did you mean tls.certificate?"),
    ("[limit]\na = 1", "s.toml:1: there is no key 'limit'; did you mean [limits]?"),
    (
        "[limits]\npose_per_second = 1",
        "s.toml:2: there is no key 'limits.pose_per_second'; did you mean limits.poses_per_second?",
    ),
    ("xyzzy = 1", "s.toml:1: there is no key 'xyzzy'; `eyeline-server config example` lists them all."),
    ("config = 'a.toml'", "s.toml:1: there is no key 'config'; "),
    ("tls = 1", "s.toml:1: tls is a section: write [tls], and its keys below"),
    ("[listen]\na = 1", "s.toml:1: listen is not to be of the kind table: give a text in quotes"),
    ("tick_hz = [1]", "s.toml:1: tick_hz is not to be of the kind array: give one value"),
    ("tick_hz = 2026-01-01", "s.toml:1: tick_hz is not to be of the kind datetime: give one value"),
    ("policy = 3", "s.toml:1: policy is not to be of the kind integer: give a text in quotes"),
    (
        "gate.keys = [3]",
        "s.toml:1: gate.keys is not to be of the kind array: give a list of texts, as in [\"a\", \"b\"]",
    ),
    ("tick_hz = 0", "s.toml:1: tick_hz = '0': give a number from 0.1 to 1000 Hz"),
    ("blur = nan", "s.toml:1: blur = 'nan': give a number from 0 to 1000 m"),
    ("blur = 0x7fffffffffffffffffffffffffffffffffff", "s.toml:1: blur = '7fff"),
    ("max_avatars = 1.5", "s.toml:1: max_avatars = '1.5': give a whole number from 1 to 1000000"),
    ("max_avatars = -1", "s.toml:1: max_avatars = '-1': give a whole number from 1 to 1000000"),
    ("policy = 'all'", "s.toml:1: policy = 'all': give one of visible, broadcast, oracle, radius, grid, pvs"),
    ("listen = 'localhost'", "s.toml:1: listen = 'localhost': give IP:PORT, for instance 127.0.0.1:4433"),
    ("audit = 'perhaps'", "s.toml:1: audit = 'perhaps': give one of true, false"),
    ("identity = ''", "s.toml:1: identity = '': it is empty; give a value, or leave the key out"),
    ("[limits]\nconnections_max = 0", "s.toml:2: limits.connections_max = '0': give a whole number from 1 to"),
    ("[gate]\naudience = \"a\\nb\"", "give a name of 1 to 64 bytes without line breaks"),
    ("a = [", "s.toml:1: this is not TOML: unclosed array"),
];

#[test]
fn what_is_wrong_in_the_file_names_itself_its_place_and_the_remedy() {
    for (text, said) in WRONG {
        let problems = load(&[], text, &[]).unwrap_err();
        assert!(problems.len() == 1 && problems[0].contains(said), "{text}: {problems:?}");
    }
    let as_text = flags(&[]).load_text("hall", "\nblur = -1").unwrap_err().to_string();
    assert_eq!(as_text, "hall:2: blur = '-1': give a number from 0 to 1000 m");
    let twice = load(&[], "blur = 1\nblur = 2", &[]).unwrap_err();
    assert!(twice[0].contains("s.toml:2: this is not TOML: duplicate key"), "{twice:?}");
    // The secret is not shown even when it is wrong.
    let seed = load(&[], "seed = -77", &[]).unwrap_err();
    assert!(seed[0].contains("seed = '…'") && !seed[0].contains("77"), "{seed:?}");
}

#[test]
fn what_is_wrong_in_the_environment_names_the_variable() {
    let cases = [
        ("EYELINE_TIKC_HZ", "1", "EYELINE_TIKC_HZ means nothing to the server; did you mean EYELINE_TICK_HZ?"),
        ("EYELINE_TLS_KEY", "a", "did you mean EYELINE_TLS__KEY?"),
        ("EYELINE_TICK_HZ", "fast", "EYELINE_TICK_HZ: tick_hz = 'fast': give a number from 0.1 to 1000 Hz"),
        ("EYELINE_GATE__ANONYMOUS_ROLE", "operator", "gate.anonymous_role = 'operator': give one of viewer, actor"),
    ];
    for (name, value, said) in cases {
        let problems = load(&[], "", &[(name, value)]).unwrap_err();
        assert!(problems.len() == 1 && problems[0].contains(said), "{problems:?}");
    }
}

#[test]
fn a_file_that_can_not_be_read_says_why_and_everything_wrong_is_told_at_once() {
    let missing = flags(&["--config", "nowhere/s.toml"]).load_from([], &[]).unwrap_err().to_string();
    assert!(missing.contains("nowhere/s.toml: No such file") && missing.contains("--config"), "{missing}");
    let (_folder, path) = file("");
    std::fs::write(&path, b"blur = 1\n# \xff\n").unwrap();
    let text = flags(&[]).with_file(&path).load_from([], &[]).unwrap_err().to_string();
    assert!(text.contains("line 2 is not UTF-8"), "{text}");
    std::fs::write(&path, vec![b'#'; (1 << 20) + 1]).unwrap();
    let text = flags(&[]).with_file(&path).load_from([], &[]).unwrap_err().to_string();
    assert!(text.contains("1048577 bytes are more than 1048576"), "{text}");

    let all = load(&[], "z = 1\nblur = -1\n\n\n\n\n\n\n\ntick_hz = 0\na = 1", &[("EYELINE_B", "1")]).unwrap_err();
    let lines: Vec<&str> = all.iter().map(|problem| problem.split(": ").next().unwrap()).collect();
    assert_eq!(lines, ["s.toml:1", "s.toml:2", "s.toml:10", "s.toml:11", "environment"]);
    let error = ConfigError { problems: all };
    assert!(error.to_string().ends_with("(and 4 more: see `eyeline-server config check`)"), "{error}");
}

#[test]
fn a_foreign_key_is_passed_over_where_it_is_said_to_be() {
    #[derive(clap::Args, Debug)]
    struct Part {
        #[arg(long, default_value_t = 1)]
        size: u32,
    }
    let (_folder, path) = file("world = 'a.glb'\nsize = 2\n");
    let flags = Flags::<Part>::none().with_file(&path);
    assert_eq!(flags.load_from([], &["world"]).unwrap().options.size, 2);
    assert!(flags.load_from([], &[]).is_err());
}

#[test]
fn the_example_is_the_defaults_and_has_every_key() {
    let example = show::example::<ServerOptions>();
    let loaded = load(&[], &example, &[]).unwrap();
    let defaults = load(&[], "", &[]).unwrap();
    assert_eq!(format!("{:?}", loaded.options), format!("{:?}", defaults.options));
    let command = command::<ServerOptions>();
    for key in keys(&command) {
        let (section, name) = key.get_id().as_str().split_once('.').unwrap_or(("", key.get_id().as_str()));
        let part = example.split("\n[").find(|part| part.starts_with(&format!("{section}]")) || section.is_empty());
        let is_there = |line: &str| line.trim_start_matches('#').starts_with(&format!("{name} = "));
        assert!(part.unwrap().lines().any(is_there), "{}", key.get_id());
        assert!(key.get_help().is_some() && key.get_id().as_str().matches('.').count() < 2, "{}", key.get_id());
    }
    // What is commented out is right as well: a line without a space after its # is a key.
    let key = |line: &str| {
        line.strip_prefix('#').filter(|rest| !rest.starts_with(' ') && !rest.is_empty()).map(str::to_owned)
    };
    let whole: Vec<String> = example.lines().map(|line| key(line).unwrap_or_else(|| line.to_owned())).collect();
    let loaded = load(&[], &whole.join("\n"), &[]).unwrap();
    assert!(loaded.settings.iter().all(|setting| setting.origin.contains("s.toml:")), "{:?}", loaded.settings);
}

#[test]
fn what_is_effective_is_printed_with_its_origin_and_without_secrets() {
    let text = "listen = '[::1]:9'\nseed = 4711\n[tls]\nkey = 'a \"b\"'\n";
    let (_folder, path) = file(text);
    let flags = flags(&["--blur", "3"]).with_file(&path);
    let printed = show::effective(&flags.load_from(variables(&[("EYELINE_TICK_HZ", "9")]), &[]).unwrap());
    let line =
        |start: &str| printed.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{printed}"));
    assert!(line("tick_hz = 9").ends_with("# EYELINE_TICK_HZ"));
    assert!(line("blur = 3").ends_with("# --blur"));
    assert!(line("listen = \"[::1]:9\"").ends_with("s.toml:1"));
    assert!(line("#pvs is not set").ends_with("# default"));
    assert!(line("#seed is set, and secret").ends_with("s.toml:2") && !printed.contains("4711"));
    // What is printed is a file of the same settings, but for the secret.
    let again = load(&[], &printed, &[]).unwrap().options.serve;
    assert_eq!((again.tick_hz, again.blur, again.tls.key), (9.0, 3.0, Some("a \"b\"".into())));
}
