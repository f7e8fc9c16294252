//! `sutura demo` as a user runs it.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");

fn demo(arguments: &[&str], out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sutura"))
        .arg("demo")
        .args(arguments)
        .arg("--out")
        .arg(out)
        .env_remove("SUTURA_LOG")
        .output()
        .unwrap()
}

fn numbers(values: &Value) -> Vec<f64> {
    values.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

/// The largest relative difference over the lowest half of the modes.
fn difference(found: &Value, reference: &Value) -> f64 {
    let (found, reference) = (numbers(found), numbers(reference));
    let lowest = found.iter().zip(&reference).take(reference.len() / 2);
    lowest.map(|(found, reference)| (found / reference - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn the_bundled_body_goes_through_the_main_job() {
    let folder = tempfile::tempdir().unwrap();
    let output = demo(&["--json"], folder.path());
    let story = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{story}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let file = std::fs::read(folder.path().join("report.json")).unwrap();
    assert_eq!(report, serde_json::from_slice::<Value>(&file).unwrap());

    let reference = std::fs::read(format!("{DATA}/reference/stomach_small.json")).unwrap();
    let reference: Value = serde_json::from_slice(&reference).unwrap();
    let before = &report["build"]["session"]["frequencies_hz"];
    assert!(difference(before, &reference["frequencies_hz_before"]) < 1e-4);
    let rounds = report["rounds"].as_array().unwrap();
    assert_eq!(rounds.len(), 2);
    assert_eq!((&rounds[0]["way"], &rounds[1]["way"]), (&"http".into(), &"zenoh".into()));
    for round in rounds {
        let frequencies = |method: &str| &round[method]["reply"]["frequencies_hz"];
        assert!(difference(frequencies("flexibility"), frequencies("from_scratch")) < 1e-4);
    }
    let after = &rounds[1]["flexibility"]["reply"]["frequencies_hz"];
    assert!(difference(after, &reference["frequencies_hz_after"]) < 1e-4);

    let seen = &report["motion"]["seen"];
    assert!(seen["n_frames"].as_u64().unwrap() >= 300);
    assert!(seen["furthest"]["max_displacement_m"].as_f64().unwrap() > 1e-3);
    // On a busy machine the watcher may lose the states of that moment: then the jump is an estimate.
    let switch = &seen["switch"];
    if switch["times_s"][0] == switch["times_s"][1] {
        assert!(switch["jump"].as_f64().unwrap() <= 0.01);
    }
    assert_eq!(seen["switch"]["to_generation"], 3);
    for picture in ["before.png", "after.png"] {
        let bytes = std::fs::read(folder.path().join(picture)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{picture}");
    }
}

#[test]
fn bad_input_ends_with_2_and_names_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let mesh = format!("{DATA}/plant_small.msh");
    let whole = std::fs::read(&mesh).unwrap();
    let truncated = path("truncated.msh", &whole[..whole.len() / 2]);
    let material = r#"{"law": "stvk", "young_modulus_pa": 1e5, "poisson_ratio": POISSON, "density_kg_m3": 1000}"#;
    let config = |name: &str, poisson: &str| {
        let material = material.replace("POISSON", poisson);
        path(name, format!("{{\"material\": {material}}}").as_bytes())
    };
    let good = config("good.json", "0.4");
    let impossible = config("impossible.json", "0.6");
    let stitches = path("stitches.json", b"[[14, 1721], [15, 1722]]");
    let out_of_range = path("out_of_range.json", b"[[14, 1721], [15, 9999]]");
    for (mesh, config, stitches, expected) in [
        (&truncated, &good, &stitches, "truncated.msh: line "),
        (&mesh, &impossible, &stitches, "/material/poisson_ratio"),
        (&mesh, &good, &out_of_range, "stitch 1 is [15, 9999]"),
    ] {
        let arguments = ["--mesh", mesh, "--config", config, "--stitches", stitches];
        let output = demo(&arguments, folder.path());
        let story = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{story}");
        assert!(story.contains(expected), "{story}");
    }
}
