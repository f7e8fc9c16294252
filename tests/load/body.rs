//! The bodies, and what is done to them.

use crate::{Failure, Options};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::session::{BasisConfig, CubatureConfig, MaterialConfig, SessionConfig};
use sutura_client::proto::simulation::SimulationConfig;
use sutura_client::{Client, Session};

/// How long a seam may take to be prepared.
const PATIENCE: Duration = Duration::from_secs(300);

/// What lies beside a mesh.
#[derive(Deserialize)]
struct Description {
    domain_materials: BTreeMap<String, MaterialConfig>,
    fixed_vertices: Vec<u32>,
    all_pairs: Vec<[u32; 2]>,
}

/// The bundled stomach: its material and the vertices that hold it.
pub(crate) fn held() -> Result<(MaterialConfig, Vec<u32>), Failure> {
    let Description { domain_materials, fixed_vertices, .. } = description()?;
    let material = *domain_materials.values().next().ok_or("no material")?;
    Ok((material, fixed_vertices))
}

/// The bundled stomach's mesh.
pub(crate) fn mesh() -> Result<Vec<u8>, Failure> {
    read("stomach_small.msh")
}

fn description() -> Result<Description, Failure> {
    Ok(serde_json::from_slice(&read("stomach_small.json")?)?)
}

fn read(name: &str) -> Result<Vec<u8>, Failure> {
    Ok(std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name))?)
}

/// The `index`-th session on the bundled stomach, simulated, with its incision prepared.
pub(crate) async fn open(
    client: Client,
    options: Options,
    index: usize,
) -> Result<Session, Failure> {
    let (mut material, fixed_vertices) = held()?;
    let all_pairs = description()?.all_pairs;
    if !options.same_body {
        // Another stiffness makes another body.
        material.young_modulus_pa *= 1.0 + 1e-3 * index as f64;
    }
    let config = SessionConfig {
        name: Some(format!("load-{index}")),
        fixed_vertices,
        n_modes: options.modes,
        basis: BasisConfig {
            size: options.basis,
            n_derivative_modes: options.modes.min(5),
            ..BasisConfig::default()
        },
        cubature: Some(CubatureConfig {
            n_points: options.points,
            n_training_poses: 40,
            tolerance: 0.2,
            ..CubatureConfig::default()
        }),
        seams: all_pairs.clone(),
        ..SessionConfig::new(material)
    };
    let session = client.create_from_file("stomach_small.msh", mesh()?, &config);
    let session = session.await?;
    session.wait_ready(|_| {}).await?;
    let deadline = Instant::now() + PATIENCE;
    while session.info().await?.n_prepared_pairs < all_pairs.len() {
        if Instant::now() > deadline {
            return Err("the seam was not prepared".into());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let simulation = SimulationConfig {
        dt_s: options.dt_s,
        publish_hz: options.publish_hz,
        ..SimulationConfig::default()
    };
    session.simulate(&simulation).await?;
    Ok(session)
}

/// The `number`-th edit: other stitches instead of those there are, whatever order edits come in.
pub(crate) fn edit(options: &Options, number: usize) -> Result<EditRequest, Failure> {
    let pairs = description()?.all_pairs;
    let pairs = (0..options.pairs).map(|i| pairs[(number * options.pairs + i) % pairs.len()]);
    let edits =
        vec![Edit::UnstitchAll {}, Edit::Stitch { pairs: pairs.collect(), stiffness_n_m: 1e5 }];
    Ok(EditRequest { deadline_ms: options.deadline_ms, ..EditRequest::new(edits) })
}
