//! Opens a session on a mesh, closes its incision, pulls at it and watches it move:
//! `stitch http://127.0.0.1:8080 stomach_small.msh stomach_small.json`

use serde_json::{Value, from_value};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::session::{MaterialConfig, SessionConfig};
use sutura_client::proto::simulation::{Force, SimulationConfig};
use sutura_client::{Client, Tracker};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut argument = || arguments.next().ok_or("usage: stitch ADDRESS MESH DESCRIPTION");
    let (address, mesh, description) = (argument()?, argument()?, argument()?);

    let mut described: Value = serde_json::from_slice(&std::fs::read(description)?)?;
    let pairs: Vec<[u32; 2]> = from_value(described["stitches"].take())?;
    let mut config = SessionConfig::new(MaterialConfig::stvk(2e4, 0.45, 1050.0));
    config.fixed_vertices = from_value(described["fixed_vertices"].take())?;
    config.seams = pairs.clone();

    let client = Client::connect(&address).await?;
    let session = client.create_from_file(&mesh, std::fs::read(&mesh)?, &config).await?;
    let info = session.wait_ready(|event| eprintln!("{event:?}")).await?;
    println!("before: {:.3?} Hz", &info.frequencies_hz[..3]);

    let stitch = Edit::Stitch { pairs: pairs.clone(), stiffness_n_m: 1e5 };
    let reply = session.edit(&EditRequest::new(vec![stitch])).await?;
    println!("after:  {:.3?} Hz", &reply.frequencies_hz[..3]);

    session.simulate(&SimulationConfig::default()).await?;
    let vertex = pairs[0][0];
    let force = Force { vertex, force_n: [0.0, 0.1, 0.0], duration_s: 0.2 };
    session.push_forces(&[force]).await?;

    let mut states = session.states().await?;
    let mut tracker = Tracker::new(&session).await?;
    while let Some(state) = states.next().await? {
        let displacement = tracker.displacement(&state).await?;
        let at = 3 * vertex as usize;
        println!("{:.2} s: {:.2e} m", state.time_s, displacement[at + 1]);
        if state.time_s > 0.5 {
            break;
        }
    }
    session.delete().await?;
    Ok(())
}
