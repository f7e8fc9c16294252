//! `sutura demo`: the main job from start to end. A daemon is started in this process; everything
//! else is done as any client would do it.
//!
//! Prepare a body, close its incision in two rounds (over HTTP and over Zenoh), let it swing while
//! another process watches, edit it in mid-motion, and leave a report and two pictures.

mod case;
mod console;
mod error;
mod motion;
mod progress;
mod report;
mod response;
mod rounds;
mod subscriber;

pub(crate) use error::DemoError;
pub(crate) use subscriber::{SubscriberArgs, run as watch};

use crate::config::{Config, DataPath, ZenohEndpoint};
use crate::daemon::Daemon;
use case::Case;
use clap::Args;
use console::Console;
use error::Doing;
use motion::{Load, Motion};
use nalgebra::Vector3;
use progress::BuildProgress;
use report::{BuildReport, CaseReport, Report};
use response::Compliance;
use rounds::{Patients, RoundReport, Way};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Instant;
use sutura_client::proto::edit::Edit;
use sutura_client::{Arrays, Client, Generation, Session, ZenohClient};
use sutura_picture::{Album, Picture};

/// The hidden command that runs the watching process.
pub(crate) const SUBSCRIBER_COMMAND: &str = "demo-subscriber";

/// The displacement field may change by this fraction when an edit takes effect.
const MAX_JUMP: f64 = 0.01;

/// Options of `sutura demo`.
#[derive(Debug, Args)]
pub(crate) struct DemoArgs {
    /// Mesh file (Gmsh .msh, VTK .vtk or .vtu, Vega .veg) to use instead of the bundled stomach.
    #[arg(long, value_name = "FILE", requires_all = ["config", "stitches"])]
    mesh: Option<PathBuf>,
    /// How to prepare it: the JSON body of `POST /v1/sessions`, without `mesh`.
    #[arg(long, value_name = "FILE", requires = "mesh")]
    config: Option<PathBuf>,
    /// Which vertices to stitch: JSON, [[a, b], …], zero-based.
    #[arg(long, value_name = "FILE", requires = "mesh")]
    stitches: Option<PathBuf>,
    /// Stiffness of every stitch of your own mesh, in N/m.
    #[arg(long, value_name = "N/M", requires = "mesh", default_value_t = case::DEFAULT_STITCH_STIFFNESS_N_M)]
    stitch_stiffness: f64,
    /// Folder for the report and the pictures.
    #[arg(long, value_name = "DIR", default_value = "sutura-demo")]
    out: PathBuf,
    /// What the embedded daemon logs, such as `debug` or `info,sutura_store=debug`.
    #[arg(long, env = "SUTURA_LOG", value_name = "FILTER", default_value = "warn")]
    log: String,
    /// Print the report as JSON on standard output, and the story on standard error.
    #[arg(long)]
    json: bool,
}

impl DemoArgs {
    /// A daemon on free loopback ports.
    pub(crate) fn daemon_config(&self) -> Config {
        let free_port = SocketAddr::from(([127, 0, 0, 1], 0));
        let mut config = Config::default();
        config.data.path = DataPath(None);
        config.http.listen = free_port;
        config.zenoh.listen = ZenohEndpoint(free_port);
        config.log.filter = self.log.clone();
        config
    }

    fn case(&self) -> Result<Case, DemoError> {
        match (&self.mesh, &self.config, &self.stitches) {
            (Some(mesh), Some(config), Some(stitches)) => {
                Case::from_files(mesh, config, stitches, self.stitch_stiffness)
            }
            _ => Case::bundled(),
        }
    }
}

/// Runs the demonstration against `daemon`.
pub(crate) async fn run(args: &DemoArgs, daemon: &Daemon) -> Result<(), DemoError> {
    let console = Console { json: args.json };
    let case = args.case()?;
    std::fs::create_dir_all(&args.out)
        .map_err(DemoError::system(format!("making the folder {}", args.out.display())))?;
    console.line(&format!("{}: {}", case.name, case.source));
    console.line(&format!(
        "A daemon serves {} and {}; from here on this is a client of it.",
        daemon.http_url(),
        daemon.zenoh_endpoint()
    ));
    let client = Client::connect(&daemon.http_url()).await.doing("reaching the daemon")?;
    let bus = ZenohClient::open(&daemon.zenoh_endpoint()).await.doing("joining Zenoh")?;

    let (session, build) = prepare(console, &client, &case).await?;
    let open = fork(&session, &case, "open").await?;
    let rounds = close_incision(console, &session, &bus, &case, &build).await?;
    let scene = set_in_motion(console, daemon, &session, &open, &case, &build, &rounds).await?;
    let report = Report {
        case: CaseReport::of(&case),
        pictures: draw(&args.out, &case, &scene)?,
        build,
        rounds,
        motion: scene.motion,
    };
    let path = report.write(&args.out)?;
    bus.close().await.doing("leaving Zenoh")?;

    console.heading(&format!("Report: {}", path.display()));
    for picture in &report.pictures {
        console.line(&format!("Picture: {}", picture.display()));
    }
    if args.json {
        report.print();
    }
    report.check()
}

/// Uploads the mesh and waits until the session is ready.
async fn prepare(
    console: Console,
    client: &Client,
    case: &Case,
) -> Result<(Session, BuildReport), DemoError> {
    console.heading(&format!(
        "Preparing {} vertices, {} tets",
        case.mesh.vertices().len(),
        case.mesh.tets().len()
    ));
    let start = Instant::now();
    let session = client
        .create_from_file(&case.file_name, case.file.clone(), &case.config)
        .await
        .doing("opening a session")?;
    let mut progress = BuildProgress::new(console);
    let info = session.wait_ready(|event| progress.event(event)).await;
    progress.finish();
    let build = BuildReport {
        wall_ms: 1e3 * start.elapsed().as_secs_f64(),
        session: info.doing("preparing the body")?,
    };
    build.print(console);
    Ok((session, build))
}

async fn fork(session: &Session, case: &Case, part: &str) -> Result<Session, DemoError> {
    let name = format!("{}-{part}", case.name);
    session.fork(Some(&name)).await.doing("forking the session")
}

/// Two rounds: the first half of the stitches over HTTP, the second over Zenoh.
async fn close_incision(
    console: Console,
    session: &Session,
    bus: &ZenohClient,
    case: &Case,
    build: &BuildReport,
) -> Result<Vec<RoundReport>, DemoError> {
    let patients = Patients {
        main: session,
        main_on_bus: &bus.session(session.id()).doing("naming the session")?,
        low_rank: &fork(session, case, "low_rank").await?,
        from_scratch: &fork(session, case, "from_scratch").await?,
    };
    let mut before = build.session.frequencies_hz.clone();
    let mut rounds = Vec::new();
    for ((round, way), pairs) in (1..).zip([Way::Http, Way::Zenoh]).zip(case.rounds()) {
        let stiffness = case.stitch_stiffness_n_m;
        let report = rounds::close(&patients, way, round, pairs, stiffness, before).await?;
        report.print(console);
        before = report.flexibility.reply.frequencies_hz.clone();
        rounds.push(report);
    }
    for finished in [patients.low_rank, patients.from_scratch] {
        finished.delete().await.doing("deleting a fork")?;
    }
    Ok(rounds)
}

/// What there is to see: the open and the closed body under the same loads.
struct Scene {
    motion: Motion,
    pull: (u32, Vector3<f64>),
    /// `None` where the open body could not be simulated.
    open: Option<Vec<f32>>,
    closed: Vec<f32>,
}

async fn set_in_motion(
    console: Console,
    daemon: &Daemon,
    session: &Session,
    open: &Session,
    case: &Case,
    build: &BuildReport,
    rounds: &[RoundReport],
) -> Result<Scene, DemoError> {
    let last = rounds.last().map(|round| &round.flexibility.reply);
    let last = last.ok_or_else(|| DemoError::Unexpected("no round was made".to_owned()))?;
    if last.n_rigid_modes > 0 {
        return Err(DemoError::Input(format!(
            "{}: the stitched body still has {} rigid modes, and only bodies held in place can be \
             simulated so far; fix vertices, or stitch every component to one that is held",
            case.name, last.n_rigid_modes
        )));
    }
    let modes = session.modes(Generation::Current).await.doing("fetching the modes")?;
    let pull = Compliance::new(&modes, &last.frequencies_hz).pull(&case.mesh);
    let open_modes = open.modes(Generation::Current).await.doing("fetching the modes")?;
    let mut forces = Compliance::new(&open_modes, &build.session.frequencies_hz)
        .gape(&case.mesh, &case.stitches);
    forces.push(pull);
    let lowest_hz = last.frequencies_hz.first().copied().unwrap_or(1.0);
    let config = motion::simulation_config(lowest_hz);
    let load = Load { forces, duration_s: 0.5 / lowest_hz };

    console.heading(&format!(
        "Pulling vertex {} with {:.3} N for {:.2} s, and the two sides of every stitch apart",
        pull.0,
        pull.1.norm(),
        load.duration_s
    ));
    let open_displacement = if build.session.n_rigid_modes == 0 {
        let (furthest, displacement) = motion::swing_open(open, &config, &load).await?;
        console.line(&format!(
            "  open body, over a WebSocket: up to {:.2} mm",
            1e3 * furthest.max_displacement_m
        ));
        Some(displacement)
    } else {
        console.line("  the open body has free parts and is not simulated");
        None
    };
    let edits = loosen(case, last.stitch_ids.last(), build.session.n_rigid_modes > 0);
    let endpoint = daemon.zenoh_endpoint();
    let motion = motion::swing_closed(console, session, &endpoint, &config, &load, edits).await?;
    report::print_motion(console, &motion);
    let closed = motion::displacement(session, &motion.seen.furthest).await?;
    open.delete().await.doing("deleting a fork")?;
    Ok(Scene { motion, pull, open: open_displacement, closed })
}

/// The edit in mid-motion: the last stitch is released, or, where parts of the body hang on their
/// stitches, replaced by one a hundred times as soft.
fn loosen(case: &Case, stitch_id: Option<&u64>, hangs_on_stitches: bool) -> Vec<Edit> {
    let mut edits = vec![Edit::Unstitch { stitch_ids: stitch_id.into_iter().copied().collect() }];
    if hangs_on_stitches {
        edits.push(Edit::Stitch {
            pairs: case.stitches.last().copied().into_iter().collect(),
            stiffness_n_m: 0.01 * case.stitch_stiffness_n_m,
        });
    }
    edits
}

/// Draws the open and the closed body, seen from the same side at the same scale.
fn draw(folder: &Path, case: &Case, scene: &Scene) -> Result<Vec<PathBuf>, DemoError> {
    let rest = vec![0.0; scene.closed.len()];
    let before = scene.open.as_deref().unwrap_or(&rest);
    let album = Album::new(
        case.mesh.vertices(),
        case.mesh.tets(),
        &case.stitches,
        &[before, &scene.closed],
    );
    let load = format!(
        "Vertex {} pulled with {:.3} N, the two sides of every stitch pulled apart.\n\
         Shown where the body is furthest from rest; true to scale.",
        scene.pull.0,
        scene.pull.1.norm()
    );
    let caption =
        if scene.open.is_some() { load.as_str() } else { "At rest: parts of it are free." };
    let pictures = [
        ("before.png", "before stitching", before, caption, &[][..]),
        ("after.png", "after stitching", &scene.closed, load.as_str(), &case.stitches),
    ];
    let mut paths = Vec::new();
    for (file_name, when, displacement, caption, stitches) in pictures {
        let path = folder.join(file_name);
        let failed = || DemoError::system(format!("writing {}", path.display()));
        let file = std::fs::File::create(&path).map_err(failed())?;
        let title = format!("{}, {when}", case.name);
        let picture = Picture { title: &title, caption, displacement, stitches };
        album.write(&picture, file).map_err(|error| failed()(std::io::Error::other(error)))?;
        paths.push(path);
    }
    Ok(paths)
}
