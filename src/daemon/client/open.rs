//! `sutura open`: a session of a running daemon on a mesh file.

use super::{ClientArgs, ClientError, print_json, print_session, read, read_json};
use clap::Args;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use sutura_client::proto::event::Event;
use sutura_client::proto::session::SessionConfig;

/// Options of `sutura open`.
#[derive(Debug, Args)]
pub(crate) struct OpenArgs {
    /// Mesh file: Gmsh .msh, VTK .vtk or .vtu, or Vega .veg.
    mesh: PathBuf,
    /// How to prepare it: the JSON body of `POST /v1/sessions`, without `mesh`.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The session's name for people; by default that of the configuration, else of the mesh file.
    #[arg(long)]
    name: Option<String>,
    /// Print the session's identifier alone, for scripts.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
    #[command(flatten)]
    client: ClientArgs,
}

/// Opens a session, waits until it is ready and prints it.
pub(crate) async fn run(args: OpenArgs) -> Result<(), ClientError> {
    let mut config: SessionConfig = read_json(&args.config)?;
    let file_name = |part: Option<&std::ffi::OsStr>| part.map(|p| p.to_string_lossy().into_owned());
    config.name = args.name.or(config.name).or_else(|| file_name(args.mesh.file_stem()));
    let name = file_name(args.mesh.file_name()).unwrap_or_default();
    let client = args.client.connect().await?;
    let session = client.create_from_file(&name, read(&args.mesh)?, &config).await?;
    let is_watched = std::io::stderr().is_terminal();
    let mut last = String::new();
    let info = session
        .wait_ready(|event| {
            if let Event::Stage { stage, .. } = event
                && is_watched
                && *stage != last
            {
                eprintln!("  {stage} …");
                last.clone_from(stage);
            }
        })
        .await?;
    if args.quiet {
        return Ok(writeln!(std::io::stdout(), "{}", info.id)?);
    }
    if args.client.json { print_json(&info) } else { print_session(&info) }
}
