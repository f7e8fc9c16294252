//! `sutura prepare`: what a session builds, without a daemon, written for other tools.

mod progress;

use crate::export::{self, Body, Columns, ExportError, Format, Written};
use clap::Args;
use progress::StageBars;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use sutura_client::proto::Problem;
use sutura_core::build::{Artifacts, BuildError, build};
use sutura_core::mesh::MeshLimits;

/// Options of `sutura prepare`.
#[derive(Debug, Args)]
pub(crate) struct PrepareArgs {
    /// Mesh file: Gmsh .msh, VTK .vtk or .vtu, Vega .veg, or TetGen .node (its .ele lies beside it).
    mesh: PathBuf,
    /// How to prepare it: the JSON body of `POST /v1/sessions`, without `mesh`.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Folder to write into; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What to write; several with commas between.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FORMAT",
          default_values_t = [Format::Npy, Format::Vtu, Format::Glb, Format::Vega, Format::Png])]
    formats: Vec<Format>,
    /// Draw so many of the lowest modes.
    #[arg(long, value_name = "N", default_value_t = export::N_PICTURES)]
    pictures: usize,
    /// Print a summary as JSON on standard output.
    #[arg(long)]
    json: bool,
}

/// The largest mesh prepared; memory sets the limit before.
const LIMITS: MeshLimits = MeshLimits { max_vertices: 16_000_000, max_tets: 64_000_000 };

/// Why nothing, or not everything, was written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PrepareError {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// What the files say cannot be prepared.
    #[error("{}: {problem}", path.display())]
    Refused { path: PathBuf, problem: Box<Problem> },
    /// The body cannot be built.
    #[error("{}: {error}", path.display())]
    Build { path: PathBuf, error: BuildError },
    /// A file could not be written.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The summary could not be printed.
    #[error("standard output: {0}")]
    Output(#[from] std::io::Error),
}

impl PrepareError {
    /// Whether what the user gave is at fault.
    pub(crate) fn is_bad_input(&self) -> bool {
        matches!(
            self,
            PrepareError::Unreadable { .. }
                | PrepareError::Refused { .. }
                | PrepareError::Build { .. }
        )
    }
}

/// What was prepared.
#[derive(Serialize)]
struct Summary {
    name: String,
    n_vertices: usize,
    n_tets: usize,
    n_free_dofs: usize,
    n_rigid_modes: usize,
    frequencies_hz: Vec<f64>,
    basis_size: usize,
    n_cubature_points: Option<usize>,
    cubature_error: Option<f64>,
    timings_ms: BTreeMap<&'static str, f64>,
    warnings: Vec<String>,
    files: Vec<Written>,
}

/// Builds and writes.
pub(crate) fn run(args: &PrepareArgs) -> Result<(), PrepareError> {
    let config = read(&args.config)?;
    let mut files = Vec::new();
    for path in parts(&args.mesh) {
        let bytes = read(&path)?;
        files.push((path.file_name().unwrap_or_default().to_string_lossy().into_owned(), bytes));
    }
    let request = sutura_transport::read_request(config, files, &LIMITS).map_err(|problem| {
        let is_mesh = problem.instance_pointer.as_deref().is_some_and(|p| p.starts_with("/mesh"));
        let path = if is_mesh { &args.mesh } else { &args.config };
        PrepareError::Refused { path: path.clone(), problem: Box::new(problem) }
    })?;
    let bars = StageBars::new(std::io::stderr().is_terminal());
    let artifacts = build(request.mesh, &request.params, &bars)
        .map_err(|error| PrepareError::Build { path: args.config.clone(), error })?;
    bars.finish();
    let name = match request.name.as_str() {
        sutura_transport::UNNAMED => {
            args.mesh.file_stem().unwrap_or_default().to_string_lossy().into_owned()
        }
        name => name.to_owned(),
    };
    let body = body(name, &artifacts);
    let mut summary = summary(&body, &artifacts);
    drop(artifacts);
    summary.files = export::write(&body, &args.out, &args.formats, args.pictures)?;
    if args.json {
        let text = serde_json::to_string_pretty(&summary).map_err(std::io::Error::from)?;
        return Ok(writeln!(std::io::stdout(), "{text}")?);
    }
    print(&summary)
}

fn read(path: &Path) -> Result<Vec<u8>, PrepareError> {
    std::fs::read(path).map_err(|source| PrepareError::Unreadable { path: path.to_owned(), source })
}

/// The files of a mesh: TetGen has its tets beside its nodes.
fn parts(mesh: &Path) -> Vec<PathBuf> {
    let extension = mesh.extension().unwrap_or_default().to_ascii_lowercase();
    let beside = match extension.to_str() {
        Some("node") => "ele",
        Some("ele") => "node",
        _ => return vec![mesh.to_owned()],
    };
    vec![mesh.to_owned(), mesh.with_extension(beside)]
}

fn body(name: String, artifacts: &Artifacts) -> Body {
    let mesh = artifacts.mesh().as_ref().clone();
    let n_vertices = mesh.vertices().len();
    let modes = (0..artifacts.n_modes()).flat_map(|i| artifacts.mode(i)).collect();
    let basis = (0..artifacts.basis_size()).flat_map(|i| artifacts.basis_column(i)).collect();
    Body {
        name,
        has_labels: true,
        mass_kg: artifacts.lumped_mass_kg().to_vec(),
        frequencies_hz: artifacts.frequencies_hz(),
        modes: Columns::new(n_vertices, modes),
        basis: Columns::new(n_vertices, basis),
        mesh,
    }
}

fn summary(body: &Body, artifacts: &Artifacts) -> Summary {
    let cubature = artifacts.cubature();
    Summary {
        name: body.name.clone(),
        n_vertices: body.mesh.vertices().len(),
        n_tets: body.mesh.tets().len(),
        n_free_dofs: artifacts.n_free_dofs(),
        n_rigid_modes: artifacts.n_rigid_modes(),
        frequencies_hz: body.frequencies_hz.clone(),
        basis_size: artifacts.basis_size(),
        n_cubature_points: cubature.map(|rule| rule.n_points),
        cubature_error: cubature.map(|rule| rule.validation_error),
        timings_ms: artifacts
            .timings()
            .iter()
            .map(|(stage, time)| (stage.name(), 1e3 * time.as_secs_f64()))
            .collect(),
        warnings: artifacts.warnings().to_vec(),
        files: Vec::new(),
    }
}

fn print(summary: &Summary) -> Result<(), PrepareError> {
    let mut out = std::io::stdout().lock();
    let total: f64 = summary.timings_ms.values().sum();
    writeln!(out, "{}, built in {total:.0} ms", summary.name)?;
    writeln!(
        out,
        "mesh         {} vertices, {} tets, {} free dofs, {} rigid modes",
        summary.n_vertices, summary.n_tets, summary.n_free_dofs, summary.n_rigid_modes
    )?;
    let shown: Vec<String> =
        summary.frequencies_hz.iter().take(10).map(|f| format!("{f:.4}")).collect();
    writeln!(out, "frequencies  {} Hz", shown.join(" "))?;
    write!(out, "basis        {} columns", summary.basis_size)?;
    match summary.n_cubature_points.zip(summary.cubature_error) {
        Some((n, error)) => writeln!(out, ", {n} cubature points (force error {error:.1e})")?,
        None => writeln!(out, ", every tet summed")?,
    }
    for warning in &summary.warnings {
        writeln!(out, "warning      {warning}")?;
    }
    print_files(&mut out, &summary.files)?;
    Ok(())
}

/// A table of what was written.
pub(crate) fn print_files(out: &mut impl Write, files: &[Written]) -> std::io::Result<()> {
    for Written { path, what } in files {
        writeln!(out, "wrote        {}: {what}", path.display())?;
    }
    Ok(())
}
