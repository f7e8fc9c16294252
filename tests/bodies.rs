//! A small body to operate on: a bar cut in two, one half held, to be stitched together.

use std::time::{Duration, Instant};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::session::{
    BasisConfig, CubatureConfig, MaterialConfig, MeshConfig, SessionConfig,
};
use sutura_client::{Client, Session};

use crate::daemon::Daemon;

/// Cells of each half along x, y, z.
const CELLS: [usize; 3] = [4, 2, 2];
/// Edge of a cell in m.
const EDGE_M: f64 = 0.025;
/// Stiffness of the stitches in N/m.
pub(crate) const STIFFNESS_N_M: f64 = 1e5;

/// Relative force error of cubature asked for.
pub(crate) const CUBATURE_TOLERANCE: f64 = 0.02;

/// Vertices of each half.
pub(crate) const N_HALF: u32 = 45;

/// The bar: two halves of 4 × 2 × 2 cells of six tets, labelled 1 and 2, which meet at x = 0.1 m.
pub(crate) fn bar() -> MeshConfig {
    let mut mesh = MeshConfig { vertices: Vec::new(), tets: Vec::new(), domains: Vec::new() };
    for half in 0..2 {
        let first = mesh.vertices.len() as u32;
        let [nx, ny, nz] = CELLS;
        for k in 0..=nz {
            for j in 0..=ny {
                for i in 0..=nx {
                    let place = [i + half * nx, j, k];
                    mesh.vertices.push(place.map(|n| n as f64 * EDGE_M));
                }
            }
        }
        let vertex = |place: [usize; 3]| {
            first + (place[0] + (nx + 1) * (place[1] + (ny + 1) * place[2])) as u32
        };
        for cell in 0..nx * ny * nz {
            let corner = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            // Kuhn's subdivision: one tet for each order in which the three axes can be walked;
            // odd orders walk it inside out.
            for (axes, is_odd) in [
                ([0, 1, 2], false),
                ([1, 2, 0], false),
                ([2, 0, 1], false),
                ([0, 2, 1], true),
                ([2, 1, 0], true),
                ([1, 0, 2], true),
            ] {
                let mut place = corner;
                let mut tet = [vertex(corner); 4];
                for (step, axis) in axes.into_iter().enumerate() {
                    place[axis] += 1;
                    tet[step + 1] = vertex(place);
                }
                if is_odd {
                    tet.swap(2, 3);
                }
                mesh.tets.push(tet);
                mesh.domains.push(half as i64 + 1);
            }
        }
    }
    mesh
}

/// The nine pairs of vertices where the halves meet.
pub(crate) fn seam() -> Vec<[u32; 2]> {
    let n = CELLS[0] as u32 + 1;
    (0..N_HALF / n).map(|row| [row * n + n - 1, N_HALF + row * n]).collect()
}

/// A vertex at the bar's free end.
pub(crate) const TIP: u32 = 2 * N_HALF - 1;

/// The vertices that [`config`] does not hold.
pub(crate) fn free_vertices() -> Vec<u32> {
    let held = config().fixed_vertices;
    (0..2 * N_HALF).filter(|vertex| !held.contains(vertex)).collect()
}

/// A configuration for the bar, its mesh left out: the end at x = 0 is held.
pub(crate) fn config() -> SessionConfig {
    let n = CELLS[0] as u32 + 1;
    SessionConfig {
        name: Some("bar".to_owned()),
        fixed_vertices: (0..N_HALF / n).map(|row| row * n).collect(),
        n_modes: 8,
        basis: BasisConfig { size: 24, n_derivative_modes: 5, ..BasisConfig::default() },
        cubature: Some(CubatureConfig {
            n_points: 60,
            n_training_poses: 40,
            tolerance: CUBATURE_TOLERANCE,
            ..CubatureConfig::default()
        }),
        ..SessionConfig::new(MaterialConfig::stvk(5e5, 0.4, 1000.0))
    }
}

/// A session on the bar, ready.
pub(crate) async fn ready_bar(daemon: &Daemon) -> Session {
    ready_bar_of(&daemon.client().await).await
}

/// The same through a client.
pub(crate) async fn ready_bar_of(client: &Client) -> Session {
    let config = SessionConfig { mesh: Some(bar()), ..config() };
    let session = client.create(&config).await.unwrap();
    session.wait_ready(|_| {}).await.unwrap();
    session
}

/// Stitches `pairs`.
pub(crate) fn stitch(pairs: &[[u32; 2]]) -> EditRequest {
    let edit = Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m: STIFFNESS_N_M };
    EditRequest::new(vec![edit])
}

/// Makes one stitch half as stiff.
pub(crate) fn soften(stitch_id: u64) -> EditRequest {
    let stiffness_n_m = STIFFNESS_N_M / 2.0;
    EditRequest::new(vec![Edit::SetStiffness { stitch_ids: vec![stitch_id], stiffness_n_m }])
}

/// The mesh as Gmsh 2.2 text.
pub(crate) fn msh(mesh: &MeshConfig) -> String {
    let mut text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n".to_owned();
    text += &format!("{}\n", mesh.vertices.len());
    for (i, [x, y, z]) in mesh.vertices.iter().enumerate() {
        text += &format!("{} {x} {y} {z}\n", i + 1);
    }
    text += &format!("$EndNodes\n$Elements\n{}\n", mesh.tets.len());
    for (i, (tet, label)) in mesh.tets.iter().zip(&mesh.domains).enumerate() {
        let [a, b, c, d] = tet.map(|vertex| vertex + 1);
        text += &format!("{} 4 2 {label} {label} {a} {b} {c} {d}\n", i + 1);
    }
    text + "$EndElements\n"
}

/// Waits until the daemon has prepared `count` pairs of `session`.
pub(crate) async fn prepared(session: &Session, count: usize) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while session.info().await.unwrap().n_prepared_pairs < count {
        assert!(Instant::now() < deadline, "the seams were not prepared");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
