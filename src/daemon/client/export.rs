//! `sutura export`: a session of a running daemon, and its motion, in the formats of other tools.

use super::{ClientArgs, ClientError};
use crate::export::{self, Body, Columns, ExportError, Format, Recording, Written};
use crate::prepare::print_files;
use clap::Args;
use serde::Serialize;
use std::io::Write;
use std::path::PathBuf;
use sutura_client::{Arrays, Error, Generation, Session, Tracker};
use sutura_core::mesh::TetMesh;

/// Options of `sutura export`.
#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// The session.
    session: String,
    /// Folder to write into; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The generation; without it, the current one.
    #[arg(long, value_name = "NUMBER")]
    generation: Option<u64>,
    /// What to write; several with commas between.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FORMAT",
          default_values_t = [Format::Npy, Format::Vtu, Format::Glb, Format::Vega, Format::Png])]
    formats: Vec<Format>,
    /// Draw so many of the lowest modes.
    #[arg(long, value_name = "N", default_value_t = export::N_PICTURES)]
    pictures: usize,
    /// Follow the running simulation for so many seconds of simulated time, and write its motion as
    /// motion.pvd and motion.glb.
    #[arg(long, value_name = "SECONDS")]
    record: Option<f64>,
    #[command(flatten)]
    client: ClientArgs,
}

/// Why nothing, or not everything, was written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ExportCommandError {
    #[error(transparent)]
    Client(#[from] ClientError),
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error("--record takes a positive number of seconds, not {0}")]
    Duration(f64),
    #[error("the daemon's body is not one: {0}")]
    Body(String),
}

impl From<Error> for ExportCommandError {
    fn from(error: Error) -> Self {
        ExportCommandError::Client(error.into())
    }
}

impl From<std::io::Error> for ExportCommandError {
    fn from(error: std::io::Error) -> Self {
        ExportCommandError::Client(error.into())
    }
}

impl ExportCommandError {
    /// Whether what the user gave is at fault.
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            ExportCommandError::Client(error) => error.is_bad_input(),
            ExportCommandError::Duration(_) => true,
            ExportCommandError::Export(_) | ExportCommandError::Body(_) => false,
        }
    }
}

/// What was written.
#[derive(Serialize)]
struct Summary {
    session: String,
    generation: u64,
    n_states: usize,
    files: Vec<Written>,
}

/// Fetches and writes.
pub(crate) async fn run(args: ExportArgs) -> Result<(), ExportCommandError> {
    if let Some(seconds) = args.record
        && !(seconds > 0.0 && seconds.is_finite())
    {
        return Err(ExportCommandError::Duration(seconds));
    }
    let client = args.client.connect().await?;
    let session = client.session(&args.session)?;
    if args.record.is_some() {
        // Refused if nothing is simulated, before anything is written.
        session.simulation().await?;
    }
    let generation = match args.generation {
        Some(number) => number,
        None => session.info().await?.generation,
    };
    let body = fetch(&session, generation).await?;
    let mut files = export::write(&body, &args.out, &args.formats, args.pictures)?;
    let mut n_states = 0;
    if let Some(seconds) = args.record {
        let recording = Recording::new(&body, &args.out, &args.formats, generation);
        let recording = record(&session, recording, seconds).await?;
        n_states = recording.n_frames();
        files.extend(recording.finish()?);
    }
    let summary = Summary { session: args.session, generation, n_states, files };
    let mut out = std::io::stdout().lock();
    if args.client.json {
        let text = serde_json::to_string_pretty(&summary).map_err(std::io::Error::from)?;
        return Ok(writeln!(out, "{text}")?);
    }
    writeln!(out, "{}, generation {generation}", body.name)?;
    Ok(print_files(&mut out, &summary.files)?)
}

async fn fetch(session: &Session, generation: u64) -> Result<Body, ExportCommandError> {
    let wanted = Generation::Number(generation);
    let info = session.info().await?;
    let positions = session.positions::<f64>(wanted).await?;
    let tets = session.tets(wanted).await?;
    let (vertices, _) = positions.data.as_chunks::<3>();
    let mesh = TetMesh::new(vertices.to_vec(), tets, Vec::new())
        .map_err(|error| ExportCommandError::Body(error.to_string()))?;
    let n_vertices = mesh.vertices().len();
    let whole = |data: &[f64]| {
        let message = || format!("{} numbers are no vectors over its vertices", data.len());
        if data.len().is_multiple_of(3 * n_vertices) { Ok(()) } else { Err(message()) }
    };
    let modes = session.modes::<f64>(wanted).await?.data;
    let basis = session.basis::<f64>(wanted).await?;
    let basis: Vec<f64> = (0..basis.size()).flat_map(|i| basis.column(i).to_vec()).collect();
    whole(&modes).and_then(|()| whole(&basis)).map_err(ExportCommandError::Body)?;
    // Frequencies are told of the current generation alone.
    let is_current = info.generation == generation;
    Ok(Body {
        name: info.name.unwrap_or(info.id),
        has_labels: false,
        mass_kg: session.mass::<f64>(wanted).await?.data,
        frequencies_hz: if is_current { info.frequencies_hz } else { Vec::new() },
        modes: Columns::new(n_vertices, modes),
        basis: Columns::new(n_vertices, basis),
        mesh,
    })
}

async fn record<'a>(
    session: &Session,
    mut recording: Recording<'a>,
    seconds: f64,
) -> Result<Recording<'a>, ExportCommandError> {
    let mut states = session.states().await?;
    let mut tracker = Tracker::new(session.clone()).await?;
    let mut end = None;
    while let Some(state) = states.next().await? {
        let end = *end.get_or_insert(state.time_s + seconds);
        if state.time_s > end {
            break;
        }
        let displacement = tracker.displacement(&state).await?;
        recording.add(state, &displacement)?;
    }
    Ok(recording)
}
