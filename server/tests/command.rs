//! The `eyeline-server` binary: do its verbs for settings and tokens print what scripts rely on, and fail in one line?

use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

/// Runs the binary to its end in `folder`, with an environment of its own.
fn server(folder: &Path, args: &[&str], env: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eyeline-server"));
    command.current_dir(folder).args(args).env_clear().envs(env.iter().copied());
    command.output().unwrap()
}

fn said(output: &Output) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (text(&output.stdout), text(&output.stderr))
}

fn success(folder: &Path, args: &[&str]) -> String {
    let output = server(folder, args, &[]);
    let (out, err) = said(&output);
    assert_eq!(output.status.code(), Some(0), "{args:?}: {out}{err}");
    out
}

/// What it says on standard error when it fails, which must be one line and exit code 1.
fn failure(folder: &Path, args: &[&str], env: &[(&str, &str)]) -> String {
    let output = server(folder, args, env);
    let (_, err) = said(&output);
    assert_eq!(output.status.code(), Some(1), "{args:?}: {err}");
    assert!(err.starts_with("error: ") && err.lines().count() == 1, "{args:?}: {err}");
    err
}

#[test]
fn settings_are_written_checked_and_printed() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    let example = success(here, &["config", "example"]);
    let world = example.replace("#world = \"rooms.glb\"", "world = \"rooms.glb\"");
    std::fs::write(here.join("eyeline-server.toml"), &world).unwrap();
    std::fs::write(here.join("rooms.glb"), "").unwrap();
    assert_eq!(success(here, &["config", "check"]), "the settings are good\n");
    let line = 1 + world.lines().position(|line| line.starts_with("tick_hz")).unwrap();
    let printed = success(here, &["config", "print", "--blur", "3"]);
    assert!(printed.contains(&format!("# eyeline-server.toml:{line}\n")), "{printed}");
    assert!(printed.lines().any(|line| line.starts_with("blur = 3 ") && line.ends_with("# --blur")), "{printed}");

    let wrong = server(here, &["config", "check", "--blur", "2"], &[("EYELINE_TICK_HZ", "0"), ("EYELINE_BLURR", "1")]);
    let (out, err) = said(&wrong);
    assert_eq!((wrong.status.code(), out.lines().count(), err.lines().count()), (Some(1), 2, 1), "{out}{err}");
    assert!(out.contains("EYELINE_TICK_HZ: tick_hz = '0'") && out.contains("EYELINE_BLURR"), "{out}");

    std::fs::write(here.join("bad.toml"), "[gate]\nkeys = ['none.pub']\nanonymous = 'never'\n[tls]\nkey = 'k'\n")
        .unwrap();
    let (out, _) = said(&server(here, &["config", "check", "bad.toml"], &[]));
    assert!(out.contains("bad.toml:5: tls.key stands alone"), "{out}");
    assert!(out.contains("bad.toml:2: none.pub: ") && out.contains("world is not set"), "{out}");
}

#[test]
fn a_server_that_can_not_start_says_why_in_one_line() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    assert!(failure(here, &[], &[]).contains("which world? give --world FILE"));
    assert!(failure(here, &["--config", "none.toml"], &[]).contains("none.toml: No such file"));
    assert!(failure(here, &[], &[("EYELINE_TICK_HZ", "0")]).contains("EYELINE_TICK_HZ"));
    std::fs::write(here.join("eyeline-server.toml"), "worl = 'a'\nblur = -1\n").unwrap();
    let error = failure(here, &[], &[]);
    assert!(error.contains("eyeline-server.toml:1: ") && error.contains("did you mean world?"), "{error}");
    assert!(error.contains("1 more"), "{error}");
}

#[test]
fn a_token_alone_is_on_standard_output() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    std::fs::write(here.join("eyeline-server.toml"), "[gate]\naudience = 'hall'\nkeys = 't.pub'\n").unwrap();
    success(here, &["token", "key", "t.key"]);
    let issue = ["token", "issue", "--role", "actor", "--subject", "anna", "--valid", "90s", "--key", "t.key"];
    let (out, err) = said(&server(here, &issue, &[]));
    assert!(out.starts_with("v4.public.") && out.lines().count() == 1 && err.starts_with("id "), "{out}{err}");
    std::fs::write(here.join("anna"), &out).unwrap();
    let shown = success(here, &["token", "show", "anna"]);
    assert!(shown.contains("server   hall\n") && shown.contains("good     yes, signed with t.pub"), "{shown}");
    success(here, &["token", "revoke", "--key", "t.key", "--subject", "anna"]);
    assert!(success(here, &["token", "show", "anna"]).contains("good     no: it is revoked"));

    let cases: [(&[&str], &str); 7] = [
        (&["token", "key", "t.key"], "t.pub: "),
        (&["token", "show", "none"], "'none' is no token, which begins with v4.public., nor a file with one"),
        (&["token", "show", "t.key"], "this is not a token"),
        (&["token", "revoke", "--key", "t.key", "--id", "X"], "--id 'X' is not a token's name"),
        (&["token", "revoke", "--key", "none", "--id", "X"], "none: "),
        (&["token", "issue", "--role", "actor", "--subject", "a", "--key", "t.pub"], "t.pub: this is a public key"),
        (&["token", "issue", "--role", "actor", "--subject", "", "--key", "t.key"], "'' is not a subject"),
    ];
    for (args, said) in cases {
        let error = failure(here, args, &[]);
        assert!(error.contains(said), "{args:?}: {error}");
    }
}
