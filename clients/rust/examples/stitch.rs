//! Opens a session on a mesh file, closes an incision, pulls on a vertex and watches it move.

use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::session::{MaterialConfig, SessionConfig};
use sutura_client::proto::simulation::{Force, SimulationConfig};
use sutura_client::{Client, Tracker};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let client = Client::connect("http://127.0.0.1:8080").await?;
    let mut config = SessionConfig::new(MaterialConfig::stvk(5e5, 0.4, 1000.0));
    config.fixed_vertices = vec![0, 1, 2];
    let mesh = std::fs::read("organ.msh")?;
    let session = client.create_from_file("organ.msh", mesh, &config).await?;
    let info = session.wait_ready(|event| println!("{event:?}")).await?;
    println!("before: {:.3?} Hz", &info.frequencies_hz);

    let pairs = vec![[17, 4021], [18, 4022]];
    let stitch = Edit::Stitch { pairs, stiffness_n_m: 1e5 };
    let reply = session.edit(&EditRequest::new(vec![stitch])).await?;
    println!("after:  {:.3?} Hz", &reply.frequencies_hz);

    session.simulate(&SimulationConfig::default()).await?;
    let force = Force { vertex: 9, force_n: [0.0, 1.0, 0.0], duration_s: 0.2 };
    session.push_forces(&[force]).await?;
    let mut states = session.states().await?;
    let mut tracker = Tracker::new(session).await?;
    while let Some(state) = states.next().await? {
        let displacement = tracker.displacement(&state).await?;
        println!("{:.3} s: {:?} m", state.time_s, &displacement[27..30]);
    }
    Ok(())
}
