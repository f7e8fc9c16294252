//! The architecture's walls (see `src/ARCHITECTURE.md`), held up against `cargo metadata` and the
//! sources.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Every file past this is split by subject.
const MAX_LINES: usize = 700;

/// File names that name no subject.
const VAGUE_NAMES: [&str; 7] = ["common", "helper", "helpers", "misc", "types", "util", "utils"];

/// The core's stages in the order of the data flow: each imports only those to its left.
const STAGES: [&str; 12] = [
    "material",
    "mesh",
    "edit",
    "assembly",
    "factorization",
    "modes",
    "closing",
    "derivatives",
    "basis",
    "cubature",
    "reduced",
    "build",
];

/// Modules of the core that belong to no stage and import none.
const SHARED_BY_STAGES: [&str; 5] = ["control", "dictionary", "lanes", "linalg", "pool"];

/// What the pure core may not reach for.
const IMPURE: [&str; 8] = [
    "std::env",
    "std::fs",
    "std::net",
    "std::process",
    "std::time::Instant",
    "Instant::now",
    "SystemTime",
    "tokio",
];

/// The dependency graph of the workspace, tests' own dependencies left out.
struct Graph {
    name_of: BTreeMap<String, String>,
    dependencies_of: BTreeMap<String, Vec<String>>,
}

impl Graph {
    fn load() -> Graph {
        let host = run(&["-vV"]);
        let host = host.lines().find_map(|line| line.strip_prefix("host: ")).unwrap().to_owned();
        let metadata: Value = serde_json::from_str(&run(&[
            "metadata",
            "--format-version=1",
            "--locked",
            "--offline",
            "--filter-platform",
            &host,
        ]))
        .unwrap();
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let packages = metadata["packages"].as_array().unwrap();
        let nodes = metadata["resolve"]["nodes"].as_array().unwrap();
        let dependencies = |node: &Value| {
            let is_needed = |dependency: &&Value| {
                let kinds = dependency["dep_kinds"].as_array().unwrap();
                kinds.iter().any(|kind| kind["kind"] != "dev")
            };
            let dependencies = node["deps"].as_array().unwrap().iter();
            dependencies.filter(is_needed).map(|dependency| text(&dependency["pkg"])).collect()
        };
        Graph {
            name_of: packages.iter().map(|p| (text(&p["id"]), text(&p["name"]))).collect(),
            dependencies_of: nodes.iter().map(|n| (text(&n["id"]), dependencies(n))).collect(),
        }
    }

    fn id(&self, name: &str) -> &str {
        self.name_of.iter().find(|(_, other)| *other == name).map(|(id, _)| id.as_str()).unwrap()
    }

    /// The crates that `name` depends on directly.
    fn direct(&self, name: &str) -> BTreeSet<&str> {
        self.dependencies_of[self.id(name)].iter().map(|id| self.name_of[id].as_str()).collect()
    }

    /// The crates that `name` depends on, directly or not.
    fn transitive(&self, name: &str) -> BTreeSet<&str> {
        let mut reached = BTreeSet::new();
        let mut pending = vec![self.id(name)];
        while let Some(id) = pending.pop() {
            let dependencies = self.dependencies_of[id].iter().map(String::as_str);
            pending.extend(dependencies.filter(|dependency| reached.insert(*dependency)));
        }
        reached.into_iter().map(|id| self.name_of[id].as_str()).collect()
    }
}

fn run(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO")).args(arguments).current_dir(ROOT).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The Rust files below `folder`, by their path from the root.
fn sources(folder: &str) -> Vec<(String, String)> {
    let mut pending = vec![Path::new(ROOT).join(folder)];
    let mut files = Vec::new();
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path: PathBuf = entry.unwrap().path();
            if path.is_dir() {
                pending.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                let name = path.strip_prefix(ROOT).unwrap().to_str().unwrap().replace('\\', "/");
                files.push((name, text));
            }
        }
    }
    assert!(!files.is_empty(), "no sources in {folder}");
    files.sort();
    files
}

/// The sources below `folder` without tests and comments.
fn code(folder: &str) -> Vec<(String, String)> {
    // A build script is no part of what it builds.
    let is_outside = |name: &str| {
        name.ends_with("/tests.rs") || name.contains("/tests/") || name == "src/transport/build.rs"
    };
    let strip = |text: String| {
        let tests = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
        let lines = text[..tests].lines().filter(|line| !line.trim_start().starts_with("//"));
        lines.collect::<Vec<_>>().join("\n")
    };
    let files = sources(folder).into_iter();
    files.filter(|(name, _)| !is_outside(name)).map(|(name, text)| (name, strip(text))).collect()
}

/// The crate modules that `text` names as `crate::module`.
fn modules_named(text: &str) -> BTreeSet<&str> {
    text.match_indices("crate::")
        .map(|(at, prefix)| {
            let rest = &text[at + prefix.len()..];
            let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
            &rest[..end]
        })
        .collect()
}

fn assert_none(what: &str, offenders: Vec<String>) {
    assert!(offenders.is_empty(), "{what}:\n  {}", offenders.join("\n  "));
}

#[test]
fn crates_depend_only_on_what_lies_behind_them() {
    let graph = Graph::load();
    let server = ["sutura-core", "sutura-store", "sutura-transport", "sutura"];
    let forbidden: [(&str, &[&str]); 6] = [
        ("sutura-reduced", &["tokio", "serde", "sutura-core", "sutura-proto"]),
        ("sutura-core", &["tokio", "axum", "zenoh", "serde", "sutura-store", "sutura-proto"]),
        ("sutura-store", &["axum", "hyper", "zenoh", "sutura-transport", "sutura-proto"]),
        ("sutura-objects", &["axum", "zenoh", "sutura-transport", "sutura-proto"]),
        ("sutura-proto", &["tokio", "axum", "zenoh"]),
        ("sutura-client", &["axum"]),
    ];
    let mut offenders = Vec::new();
    for (name, forbidden) in forbidden {
        let reached = graph.transitive(name);
        let outside = ["sutura-proto", "sutura-client"].contains(&name);
        let servers = server.iter().filter(|_| outside);
        for other in forbidden.iter().chain(servers).filter(|other| reached.contains(*other)) {
            offenders.push(format!("{name} depends on {other}"));
        }
    }
    for (name, other) in [("sutura", "axum"), ("sutura", "zenoh")] {
        if graph.direct(name).contains(other) {
            offenders.push(format!("{name} names {other}, which is transport's"));
        }
    }
    assert_none("dependencies through a wall", offenders);
}

#[test]
fn the_core_is_pure() {
    let mut offenders = Vec::new();
    for (name, text) in code("src/core").into_iter().chain(code("src/reduced")) {
        for word in IMPURE.iter().filter(|word| text.contains(*word)) {
            offenders.push(format!("{name}: {word}"));
        }
    }
    assert_none("the core reaches for the outside world", offenders);
}

#[test]
fn only_the_daemon_reads_arguments_and_the_environment() {
    let mut offenders = Vec::new();
    for folder in ["src/store", "src/objects", "src/transport", "proto", "clients/rust"] {
        // Examples are programs of their own.
        let library = code(folder).into_iter().filter(|(name, _)| !name.contains("/examples/"));
        let reaching = library.filter(|(_, text)| text.contains("std::env"));
        offenders.extend(reaching.map(|(name, _)| name));
    }
    assert_none("std::env outside the daemon", offenders);
}

#[test]
fn a_stage_imports_only_stages_to_its_left() {
    let mut offenders = Vec::new();
    for (name, text) in code("src/core") {
        let inside = name.strip_prefix("src/core/").unwrap();
        let stage = inside.split(['/', '.']).next().unwrap();
        if ["lib", "testing"].contains(&stage) {
            continue;
        }
        let place = |module: &str| STAGES.iter().position(|stage| *stage == module);
        if place(stage).is_none() && !SHARED_BY_STAGES.contains(&stage) {
            offenders.push(format!("{name}: {stage} has no place in the order of stages"));
        }
        for module in modules_named(&text) {
            // None < Some(0): what all stages share imports no stage.
            if module != stage && place(module) > place(stage) {
                offenders.push(format!("{name} imports {module}"));
            }
        }
    }
    assert_none("the core's data flow is left to right", offenders);
}

#[test]
fn files_have_one_subject_and_say_which() {
    let mut offenders = Vec::new();
    for folder in ["src", "proto", "clients/rust", "tests"] {
        for (name, text) in sources(folder) {
            let n_lines = text.lines().count();
            if n_lines > MAX_LINES {
                offenders.push(format!("{name} has {n_lines} lines"));
            }
            let mut words = name.trim_end_matches(".rs").split('/');
            if let Some(vague) = words.find(|word| VAGUE_NAMES.contains(word)) {
                offenders.push(format!("{name}: “{vague}” names no subject"));
            }
        }
    }
    assert_none("long or vaguely named files", offenders);
}

#[test]
fn unsafe_code_is_forbidden_in_every_crate() {
    let root = std::fs::read_to_string(Path::new(ROOT).join("Cargo.toml")).unwrap();
    assert!(root.contains("[workspace.lints.rust]\nunsafe_code = \"forbid\"\n"));
    let metadata = run(&["metadata", "--format-version=1", "--locked", "--offline", "--no-deps"]);
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let members = metadata["packages"].as_array().unwrap();
    assert!(members.len() > 5);
    let manifests = members.iter().map(|member| member["manifest_path"].as_str().unwrap());
    let inherits = |path: &str| {
        std::fs::read_to_string(path).unwrap().contains("\n[lints]\nworkspace = true\n")
    };
    let offenders = manifests.filter(|path| !inherits(path)).map(str::to_owned).collect();
    assert_none("crates that do not inherit the workspace's lints", offenders);
}
