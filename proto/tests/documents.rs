//! The JSON documents: the contract's own examples, defaults, refusals; the same ones as bincode.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use sutura_proto::edit::{Certificate, Closing, EditTimings, MAX_PAIRS, Verdict};
use sutura_proto::edit::{CubatureInfo, CubatureSource, Edit, EditMethod, EditReply, EditRequest};
use sutura_proto::evaluate::{Coordinates, EvaluateReply, EvaluateRequest, Evaluation, MAX_BATCH};
use sutura_proto::event::{Event, GenerationInfo};
use sutura_proto::session::{CubatureConfig, MassConfig, SessionConfig};
use sutura_proto::simulation::{
    Force, ForceRequest, Grab, GrabRequest, IntegratorConfig, SimulationConfig,
};
use sutura_proto::{Invalid, Problem, bus};

fn parse<T: serde::de::DeserializeOwned>(document: Value) -> Result<T, serde_json::Error> {
    serde_json::from_str(&document.to_string())
}

fn pointer(result: Result<(), Invalid>) -> String {
    result.unwrap_err().pointer
}

/// The example of the contract's section on sessions, whole.
fn example_config() -> Value {
    json!({ "name": "liver-7",
      "material": {"law": "stvk", "young_modulus_pa": 5e5, "poisson_ratio": 0.4, "density_kg_m3": 1000},
      "domain_materials": {"2": {"law": "stvk", "young_modulus_pa": 5e6, "poisson_ratio": 0.4, "density_kg_m3": 1000}},
      "fixed_vertices": [0, 1, 2], "mass": "lumped", "n_modes": 30,
      "basis": {"size": 60, "n_derivative_modes": 8},
      "cubature": {"n_points": 120, "n_training_poses": 100, "tolerance": 0.05, "seed": 1},
      "damping": {"rayleigh_mass_per_s": 0.1, "rayleigh_stiffness_s": 0.001},
      "seams": [[17, 4021], [18, 4022]] })
}

/// The example of the contract's section on edits, whole.
fn example_edits() -> Value {
    json!({ "base_generation": 0, "method": "flexibility", "tolerance": 1e-4,
      "edits": [ {"stitch": {"pairs": [[17, 4021], [18, 4022]], "stiffness_n_m": 1e5}},
                 {"unstitch": {"stitch_ids": [3, 4]}},
                 {"scale_stiffness": {"domain": 2, "factor": 100.0}},
                 {"set_stiffness": {"stitch_ids": [5], "stiffness_n_m": 2e5}},
                 {"unstitch_all": {}},
                 {"fix": {"vertices": [7, 8]}},
                 {"release": {"vertices": [7]}},
                 {"close": {"pairs": [[1, 9]], "stiffness_n_m": 1e5}},
                 {"close": {"pairs": [[2, 8]], "stiffness_n_m": 1e5, "max_gap_m": 1e-3}} ] })
}

fn edit_reply() -> EditReply {
    EditReply {
        generation: 1,
        method: EditMethod::LowRank,
        stitch_ids: vec![5, 6],
        closings: vec![Closing {
            edit: 0,
            gaps_m: vec![1e-10, 2e-10],
            dropped_energy_j: 3e-4,
            largest_displacement_m: 0.01,
            residual: 1e-9,
        }],
        n_stitches: 2,
        n_rigid_modes: 0,
        eigenvalues_per_s2: vec![1.5, 2.5],
        frequencies_hz: vec![0.25],
        residuals: vec![1e-9],
        certificate: Certificate {
            verdict: Verdict::Patched,
            lower_eigenvalue_error: 1e-5,
            upper_eigenvalue_error: 1e-3,
            basis_angle: 0.02,
            cubature_error: Some(0.04),
            is_met: true,
            is_unfinished: false,
        },
        basis_size: 60,
        cubature: Some(CubatureInfo {
            n_points: 120,
            source: CubatureSource::Refitted,
            validation_error: 0.02,
        }),
        timings_ms: EditTimings {
            linear: 1.0,
            total: 2.0,
            stages: BTreeMap::from([("modes".to_owned(), 1.0)]),
            ..EditTimings::default()
        },
        warnings: vec!["slow".to_owned()],
    }
}

#[test]
fn the_contracts_session_example_is_read_and_round_trips() {
    let config: SessionConfig = parse(example_config()).unwrap();
    config.validate().unwrap();
    assert_eq!(config.domain_materials[&2].young_modulus_pa, 5e6);
    assert_eq!(config.seams, [[17, 4021], [18, 4022]]);
    assert_eq!(parse::<SessionConfig>(serde_json::to_value(&config).unwrap()).unwrap(), config);
}

#[test]
fn defaults_are_those_of_the_contract() {
    let config: SessionConfig = parse(json!({"material": example_config()["material"]})).unwrap();
    config.validate().unwrap();
    assert_eq!(config, SessionConfig::new(config.material.unwrap()));
    assert_eq!((config.mass, config.n_modes), (MassConfig::Lumped, 30));
    assert_eq!((config.basis.size, config.basis.n_derivative_modes), (60, 8));
    assert_eq!(config.cubature, Some(CubatureConfig::default()));
    let skipped: SessionConfig =
        parse(json!({"material": example_config()["material"], "cubature": null})).unwrap();
    assert_eq!(skipped.cubature, None);
    let echoed: SessionConfig = parse(serde_json::to_value(&skipped).unwrap()).unwrap();
    assert_eq!(echoed.cubature, None);
    let simulation: SimulationConfig = parse(json!({})).unwrap();
    assert_eq!(simulation, SimulationConfig::default());
}

#[test]
fn unknown_members_are_refused_by_name() {
    let with = |pointer: &str, mut document: Value| {
        document.pointer_mut(pointer).unwrap()["speling"] = json!(1);
        document
    };
    for at in ["", "/material", "/domain_materials/2", "/basis", "/cubature", "/damping"] {
        let error = parse::<SessionConfig>(with(at, example_config())).unwrap_err().to_string();
        assert!(error.contains("speling"), "{at}: {error}");
    }
    let edits = [
        "stitch",
        "unstitch",
        "scale_stiffness",
        "set_stiffness",
        "unstitch_all",
        "fix",
        "release",
        "close",
    ];
    let edits = edits.iter().enumerate().map(|(i, edit)| format!("/edits/{i}/{edit}"));
    for at in edits.chain([String::new()]) {
        let at = at.as_str();
        let error = parse::<EditRequest>(with(at, example_edits())).unwrap_err().to_string();
        assert!(error.contains("speling"), "{at}: {error}");
    }
    assert!(parse::<SimulationConfig>(json!({"speling": 1})).is_err());
    assert!(parse::<EvaluateRequest>(json!({"q": [1], "speling": 1})).is_err());
    assert!(parse::<ForceRequest>(json!({"forces": [], "speling": 1})).is_err());
}

#[test]
fn numbers_beyond_the_range_of_f64_are_refused() {
    let text = r#"{"edits": [{"stitch": {"pairs": [[0, 1]], "stiffness_n_m": 1e999}}]}"#;
    assert!(serde_json::from_str::<EditRequest>(text).is_err());
    assert!(serde_json::from_str::<EvaluateRequest>(r#"{"q": [1e999]}"#).is_err());
}

#[test]
fn impossible_sessions_are_located() {
    let refused = |at: &str, value: Value| {
        let mut document = example_config();
        *document.pointer_mut(at).unwrap() = value;
        assert_eq!(pointer(parse::<SessionConfig>(document).unwrap().validate()), at);
    };
    refused("/name", json!(""));
    refused("/name", json!("a\nb"));
    refused("/material/poisson_ratio", json!(0.5));
    refused("/material/young_modulus_pa", json!(-1));
    refused("/domain_materials/2/density_kg_m3", json!(0));
    refused("/n_modes", json!(0));
    refused("/basis/size", json!(100_000));
    refused("/basis/n_derivative_modes", json!(65));
    refused("/cubature/n_points", json!(0));
    refused("/cubature/tolerance", json!(0));
    refused("/damping/rayleigh_stiffness_s", json!(-1e-3));
    refused("/seams/1", json!([18, 18]));
    let mut config: SessionConfig = parse(example_config()).unwrap();
    config.material = None;
    config.validate().unwrap();
    config.domain_materials.clear();
    assert_eq!(pointer(config.validate()), "/material");
}

#[test]
fn impossible_inline_meshes_are_located() {
    let config = |mesh: Value| {
        parse::<SessionConfig>(json!({"material": example_config()["material"], "mesh": mesh}))
            .unwrap()
    };
    let corners = json!([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    let good = config(json!({"vertices": corners, "tets": [[0, 1, 2, 3]]}));
    good.validate().unwrap();
    let none = config(json!({"vertices": corners, "tets": []}));
    assert_eq!(pointer(none.validate()), "/mesh/tets");
    let labels = config(json!({"vertices": corners, "tets": [[0, 1, 2, 3]], "domains": [1, 2]}));
    assert_eq!(pointer(labels.validate()), "/mesh/domains");
    let mut nan = good;
    nan.mesh.as_mut().unwrap().vertices[2][1] = f64::NAN;
    assert_eq!(pointer(nan.validate()), "/mesh/vertices/2/1");
}

#[test]
fn the_contracts_edit_example_is_read_and_round_trips_in_both_encodings() {
    let request: EditRequest = parse(example_edits()).unwrap();
    request.validate().unwrap();
    assert!(matches!(&request.edits[0], Edit::Stitch { pairs, .. } if pairs[1] == [18, 4022]));
    assert_eq!(parse::<EditRequest>(serde_json::to_value(&request).unwrap()).unwrap(), request);
    assert_eq!(bus::decode::<EditRequest>(&bus::encode(&request).unwrap()).unwrap(), request);
    let short: EditRequest = parse(json!({"edits": [{"unstitch": {"stitch_ids": [1]}}]})).unwrap();
    assert_eq!(short, EditRequest::new(vec![Edit::Unstitch { stitch_ids: vec![1] }]));
    assert_eq!(bus::decode::<EditRequest>(&bus::encode(&short).unwrap()).unwrap(), short);
}

#[test]
fn edit_replies_round_trip_in_both_encodings() {
    for reply in [edit_reply(), EditReply { cubature: None, ..edit_reply() }] {
        let document = serde_json::to_value(&reply).unwrap();
        assert_eq!(document["method"], "low_rank");
        assert_eq!(parse::<EditReply>(document).unwrap(), reply);
        assert_eq!(bus::decode::<EditReply>(&bus::encode(&reply).unwrap()).unwrap(), reply);
    }
    assert_eq!(serde_json::to_value(edit_reply()).unwrap()["cubature"]["source"], "refitted");
}

#[test]
fn impossible_edits_are_located() {
    let refused = |at: &str, value: Value| {
        let mut document = example_edits();
        *document.pointer_mut(at).unwrap() = value;
        assert_eq!(pointer(parse::<EditRequest>(document).unwrap().validate()), at);
    };
    refused("/tolerance", json!(0));
    refused("/edits", json!([]));
    refused("/edits/0/stitch/pairs", json!([]));
    refused("/edits/0/stitch/pairs", json!(vec![[0, 1]; MAX_PAIRS + 1]));
    refused("/edits/0/stitch/stiffness_n_m", json!(-1));
    refused("/edits/1/unstitch/stitch_ids", json!([]));
    refused("/edits/2/scale_stiffness/factor", json!(0));
    refused("/edits/3/set_stiffness/stitch_ids", json!([]));
    refused("/edits/3/set_stiffness/stiffness_n_m", json!(0));
    refused("/edits/5/fix/vertices", json!([]));
    refused("/edits/6/release/vertices", json!([]));
    refused("/edits/7/close/pairs", json!([]));
    refused("/edits/7/close/stiffness_n_m", json!(0));
    refused("/edits/8/close/max_gap_m", json!(-1));
    let mut request: EditRequest = parse(example_edits()).unwrap();
    request.tolerance = f64::NAN;
    assert_eq!(pointer(request.validate()), "/tolerance");
}

#[test]
fn hostile_bincode_is_refused_without_allocating_what_it_announces() {
    let bytes =
        bus::encode(&EditRequest::new(vec![Edit::Unstitch { stitch_ids: vec![7] }])).unwrap();
    for length in 0..bytes.len() {
        assert!(bus::decode::<EditRequest>(&bytes[..length]).is_err());
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(bus::decode::<EditRequest>(&longer).is_err());
    // base_generation: none (1 byte), method (4), tolerance (8), then the number of edits.
    let mut huge = bytes;
    huge[13..21].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(bus::decode::<EditRequest>(&huge).is_err());
}

#[test]
fn evaluation_takes_one_vector_or_a_batch() {
    let single: EvaluateRequest = parse(json!({"q": [1, 2.5], "exact": true})).unwrap();
    assert_eq!(single.q, Coordinates::Single(vec![1.0, 2.5]));
    assert!(single.exact);
    let batch: EvaluateRequest = parse(json!({"q": [[1, 2], [3, 4]]})).unwrap();
    assert_eq!(batch.q, Coordinates::Batch(vec![vec![1.0, 2.0], vec![3.0, 4.0]]));
    batch.validate().unwrap();
    let mixed = parse::<EvaluateRequest>(json!({"q": [1, [2]]})).unwrap_err().to_string();
    assert!(mixed.contains("list of numbers"), "{mixed}");
    let q = Coordinates::Batch(vec![vec![0.0], vec![f64::INFINITY]]);
    assert_eq!(pointer(EvaluateRequest { q, exact: false }.validate()), "/q/1/0");
    let q = Coordinates::Batch(vec![Vec::new(); MAX_BATCH + 1]);
    assert_eq!(pointer(EvaluateRequest { q, exact: false }.validate()), "/q");

    let evaluation = Evaluation { energy_j: 1.0, force: vec![2.0], stiffness: vec![vec![3.0]] };
    let single = EvaluateReply::Single(evaluation.clone());
    assert_eq!(
        serde_json::to_value(&single).unwrap(),
        json!({"energy_j": 1.0, "force": [2.0], "stiffness": [[3.0]]})
    );
    let batch = EvaluateReply::Batch { evaluations: vec![evaluation] };
    for reply in [single, batch] {
        assert_eq!(parse::<EvaluateReply>(serde_json::to_value(&reply).unwrap()).unwrap(), reply);
    }
}

#[test]
fn simulations_and_forces_are_checked() {
    let config: SimulationConfig = parse(json!({"dt_s": 0.01, "integrator": "implicit_newmark",
        "gravity_m_s2": [0, -9.81, 0], "publish_hz": 60}))
    .unwrap();
    config.validate().unwrap();
    assert_eq!(config.integrator, IntegratorConfig::ImplicitNewmark);
    assert_eq!(pointer(SimulationConfig { dt_s: 0.0, ..config.clone() }.validate()), "/dt_s");
    assert_eq!(
        pointer(SimulationConfig { publish_hz: 1e9, ..config.clone() }.validate()),
        "/publish_hz"
    );
    for given in [0.0, 1.0, f64::NAN] {
        let bad = SimulationConfig { substep_tolerance: Some(given), ..config.clone() };
        assert_eq!(pointer(bad.validate()), "/substep_tolerance");
    }
    let gravity_m_s2 = [0.0, f64::NAN, 0.0];
    assert_eq!(pointer(SimulationConfig { gravity_m_s2, ..config }.validate()), "/gravity_m_s2/1");

    let config: SimulationConfig = parse(json!({"obstacles": [
            {"plane": {"point_m": [0, 0, 0], "normal": [0, 1, 0]}},
            {"capsule": {"from_m": [0, 0, 0], "to_m": [1, 0, 0], "radius_m": 0.1}}],
        "contact": {"friction": 0.5}}))
    .unwrap();
    config.validate().unwrap();
    assert_eq!((config.obstacles.len(), config.contact.damping_s_m), (2, 1.0));
    assert!(parse::<SimulationConfig>(json!({"obstacles": [{"cube": {}}]})).is_err());
    let obstacles = vec![config.obstacles[0]; 2000];
    assert_eq!(pointer(SimulationConfig { obstacles, ..config }.validate()), "/obstacles");

    let request: GrabRequest = parse(json!({"release": [3], "grabs": [
        {"id": 1, "vertex": 9, "target_m": [0, 1, 0], "stiffness_n_m": 50}]}))
    .unwrap();
    request.validate().unwrap();
    assert_eq!(bus::decode::<GrabRequest>(&bus::encode(&request).unwrap()).unwrap(), request);
    assert_eq!(pointer(GrabRequest::default().validate()), "/grabs");
    let grab = Grab { target_m: [0.0, f64::INFINITY, 0.0], ..request.grabs[0] };
    let request = GrabRequest { grabs: vec![grab], release: vec![] };
    assert_eq!(pointer(request.validate()), "/grabs/0/target_m/1");

    let request: ForceRequest =
        parse(json!({"forces": [{"vertex": 9, "force_n": [0, 1, 0], "duration_s": 0.2}]})).unwrap();
    request.validate().unwrap();
    assert_eq!(bus::decode::<ForceRequest>(&bus::encode(&request).unwrap()).unwrap(), request);
    assert_eq!(pointer(ForceRequest { forces: Vec::new() }.validate()), "/forces");
    let force = Force { vertex: 0, force_n: [0.0, 0.0, f64::NAN], duration_s: 1.0 };
    assert_eq!(pointer(ForceRequest { forces: vec![force] }.validate()), "/forces/0/force_n/2");
    let force = Force { vertex: 0, force_n: [0.0; 3], duration_s: -1.0 };
    assert_eq!(pointer(ForceRequest { forces: vec![force] }.validate()), "/forces/0/duration_s");
}

#[test]
fn events_carry_their_name() {
    let info = GenerationInfo { generation: 1, n_modes: 30, basis_size: 60, n_stitches: 2 };
    let problem = Problem {
        kind: "about:blank".to_owned(),
        title: "Unprocessable".to_owned(),
        status: 422,
        detail: "tet 3 is inverted".to_owned(),
        instance_pointer: Some("/mesh".to_owned()),
    };
    let events = [
        Event::Stage { stage: "modes".to_owned(), progress: 0.5 },
        Event::Generation(info),
        Event::Failed { error: problem.clone() },
        Event::Simulation { running: true },
        Event::Deleted,
    ];
    for event in events {
        let document = serde_json::to_value(&event).unwrap();
        assert_eq!(document["event"], event.name());
        assert_eq!(parse::<Event>(document).unwrap(), event);
    }
    assert_eq!(serde_json::to_value(&problem).unwrap()["type"], "about:blank");
    assert_eq!(problem.to_string(), "Unprocessable (422): tet 3 is inverted [at /mesh]");
}

#[test]
fn every_document_has_a_schema_and_every_reference_resolves() {
    use utoipa::OpenApi;
    let document = serde_json::to_value(sutura_proto::openapi::Components::openapi()).unwrap();
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for name in ["SessionConfig", "EditRequest", "EditReply", "Problem", "MaterialConfig"] {
        assert!(schemas.contains_key(name), "{name}");
    }
    let text = document.to_string();
    let references = text.split("\"#/components/schemas/").skip(1);
    for name in references.map(|rest| rest.split('"').next().unwrap()) {
        assert!(schemas.contains_key(name), "{name} is referred to, but not defined");
    }
}
