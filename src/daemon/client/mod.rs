//! `sutura open`, `info`, `stitch`, `watch` and `export`: a running daemon, asked from the command line. Each is a
//! thin client of HTTP; `--json` prints the daemon's own documents.

pub(crate) mod export;
pub(crate) mod open;

use clap::{Args, ValueEnum};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use sutura_client::proto::edit::{Edit, EditDerivatives, EditMethod, EditReply, EditRequest};
use sutura_client::proto::event::Event;
use sutura_client::proto::session::SessionInfo;
use sutura_client::{Client, Credentials, Error};

/// Sessions asked for at a time.
const PAGE: usize = 100;

/// Frequencies shown to people.
const N_FREQUENCIES_SHOWN: usize = 10;

/// Which daemon, and for whom the answer is.
#[derive(Debug, Args)]
pub(crate) struct ClientArgs {
    /// The daemon.
    #[arg(
        long,
        env = "SUTURA_SERVER",
        value_name = "URL",
        default_value = "http://127.0.0.1:8080"
    )]
    server: String,
    /// The key that it asks for, if it does.
    #[arg(long, env = "SUTURA_KEY", hide_env_values = true, value_name = "KEY")]
    key: Option<String>,
    /// Certificates (PEM) of the only authorities to trust in its own, instead of those of the system.
    #[arg(long, env = "SUTURA_CA", value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl ClientArgs {
    async fn connect(&self) -> Result<Client, Error> {
        let credentials = Credentials { key: self.key.clone(), ca_file: self.ca.clone() };
        Client::connect_as(&self.server, &credentials).await
    }
}

/// Options of `sutura info`.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// The session; without one, every session is listed.
    session: Option<String>,
    #[command(flatten)]
    client: ClientArgs,
}

/// Options of `sutura stitch`.
#[derive(Debug, Args)]
pub(crate) struct StitchArgs {
    /// The session.
    session: String,
    /// A pair of coinciding vertices (zero-based); may be given several times.
    #[arg(long = "pair", value_name = "A,B", value_parser = pair)]
    pairs: Vec<[u32; 2]>,
    /// A JSON file of pairs: [[17, 4021], [18, 4022]].
    #[arg(long = "pairs", value_name = "FILE", required_unless_present = "pairs")]
    pairs_file: Option<PathBuf>,
    /// Stiffness of each stitch in N/m.
    #[arg(long, value_name = "N/M")]
    stiffness: f64,
    /// How the linear modes follow.
    #[arg(long, value_enum, default_value = "flexibility")]
    method: MethodName,
    /// Which modal derivatives the basis gets inside a seam: what can be combined of prepared ones, or the
    /// stitched body's own.
    #[arg(long, value_enum, default_value = "prepared")]
    derivatives: DerivativesName,
    /// Relative eigenvalue error accepted.
    #[arg(long, default_value_t = 1e-4)]
    tolerance: f64,
    /// Answer with the best that fits into so many milliseconds, and finish in the background.
    #[arg(long)]
    deadline_ms: Option<f64>,
    /// Refuse unless this is the current generation.
    #[arg(long, value_name = "GENERATION")]
    base_generation: Option<u64>,
    #[command(flatten)]
    client: ClientArgs,
}

/// Options of `sutura watch`.
#[derive(Debug, Args)]
pub(crate) struct WatchArgs {
    /// The session.
    session: String,
    #[command(flatten)]
    client: ClientArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
enum MethodName {
    Flexibility,
    LowRank,
    FromScratch,
}

impl From<MethodName> for EditMethod {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Flexibility => EditMethod::Flexibility,
            MethodName::LowRank => EditMethod::LowRank,
            MethodName::FromScratch => EditMethod::FromScratch,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DerivativesName {
    Own,
    Prepared,
}

impl From<DerivativesName> for EditDerivatives {
    fn from(name: DerivativesName) -> Self {
        match name {
            DerivativesName::Own => EditDerivatives::Own,
            DerivativesName::Prepared => EditDerivatives::Prepared,
        }
    }
}

fn pair(text: &str) -> Result<[u32; 2], String> {
    let vertex = |text: &str| text.trim().parse::<u32>().ok();
    text.split_once(',')
        .and_then(|(a, b)| Some([vertex(a)?, vertex(b)?]))
        .ok_or_else(|| "two vertex numbers with a comma between are needed, such as 17,4021".into())
}

/// Why a client command did not succeed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ClientError {
    /// The daemon refused, or could not be reached.
    #[error("{}", with_cause(.0))]
    Daemon(#[from] Error),
    /// A file that the user named cannot be used.
    #[error("{0}")]
    File(String),
    /// The answer could not be printed.
    #[error("standard output: {0}")]
    Output(#[from] std::io::Error),
}

impl ClientError {
    /// Whether what the user gave is at fault.
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            ClientError::File(_) => true,
            ClientError::Daemon(Error::Address(_) | Error::SessionId(_) | Error::Ca { .. }) => true,
            ClientError::Daemon(error) => {
                error.status().is_some_and(|status| (400..500).contains(&status) && status != 429)
            }
            ClientError::Output(_) => false,
        }
    }

    /// Whether whoever read the output has seen enough of it.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        matches!(self, ClientError::Output(error) if error.kind() == ErrorKind::BrokenPipe)
    }
}

/// The error and, where it keeps that to itself, what lies at its bottom: "connection refused".
fn with_cause(error: &Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    let (error, cause) = (error.to_string(), cause.to_string());
    if error.contains(&cause) { error } else { format!("{error}: {cause}") }
}

/// Prints one session, or a table of all.
pub(crate) async fn info(args: InfoArgs) -> Result<(), ClientError> {
    let client = args.client.connect().await?;
    if let Some(id) = &args.session {
        let info = client.session(id)?.info().await?;
        return if args.client.json { print_json(&info) } else { print_session(&info) };
    }
    let mut sessions = Vec::new();
    let mut after = None;
    loop {
        let page = client.list(after.as_deref(), PAGE).await?;
        sessions.extend(page.sessions);
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    if args.client.json { print_json(&sessions) } else { print_table(&sessions) }
}

/// Stitches, waits for the new generation and prints it.
pub(crate) async fn stitch(args: StitchArgs) -> Result<(), ClientError> {
    let mut pairs = args.pairs;
    if let Some(path) = &args.pairs_file {
        pairs.extend(read_json::<Vec<[u32; 2]>>(path)?);
    }
    let stitch = Edit::Stitch { pairs, stiffness_n_m: args.stiffness };
    let request = EditRequest {
        base_generation: args.base_generation,
        method: args.method.into(),
        derivatives: args.derivatives.into(),
        tolerance: args.tolerance,
        deadline_ms: args.deadline_ms,
        ..EditRequest::new(vec![stitch])
    };
    let client = args.client.connect().await?;
    let reply = client.session(&args.session)?.edit(&request).await?;
    if args.client.json { print_json(&reply) } else { print_reply(&reply) }
}

/// Prints what happens to a session until it ends.
pub(crate) async fn watch(args: WatchArgs) -> Result<(), ClientError> {
    let client = args.client.connect().await?;
    let mut events = client.session(&args.session)?.events().await?;
    while let Some(event) = events.next().await? {
        if args.client.json { print_json_line(&event)? } else { print_event(&event)? }
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>, ClientError> {
    std::fs::read(path).map_err(|error| at_fault(path, &error))
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, ClientError> {
    serde_json::from_slice(&read(path)?).map_err(|error| at_fault(path, &error))
}

fn at_fault(path: &Path, error: &dyn std::fmt::Display) -> ClientError {
    ClientError::File(format!("{}: {error}", path.display()))
}

fn print_json(document: &impl Serialize) -> Result<(), ClientError> {
    let text = serde_json::to_string_pretty(document).map_err(Error::from)?;
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

fn print_json_line(document: &impl Serialize) -> Result<(), ClientError> {
    let text = serde_json::to_string(document).map_err(Error::from)?;
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// The name under which the contract writes a unit variant.
fn name_of(variant: &impl Serialize) -> String {
    let value = serde_json::to_value(variant).unwrap_or_default();
    value.as_str().unwrap_or("unknown").to_owned()
}

fn hertz(frequencies_hz: &[f64]) -> String {
    let shown: Vec<String> =
        frequencies_hz.iter().take(N_FREQUENCIES_SHOWN).map(|f| format!("{f:.4}")).collect();
    shown.join(" ")
}

fn print_table(sessions: &[SessionInfo]) -> Result<(), ClientError> {
    let mut out = std::io::stdout().lock();
    let (state, generation, vertices) = ("state", "generation", "vertices");
    writeln!(
        out,
        "{:32}  {state:10}  {generation:>10}  {vertices:>8}  {:>8}  name",
        "id", "stitches"
    )?;
    for info in sessions {
        let SessionInfo { id, generation, n_vertices, n_stitches, .. } = info;
        let (state, name) = (name_of(&info.state), info.name.as_deref().unwrap_or(""));
        writeln!(
            out,
            "{id:32}  {state:10}  {generation:>10}  {n_vertices:>8}  {n_stitches:>8}  {name}"
        )?;
    }
    Ok(())
}

fn print_session(info: &SessionInfo) -> Result<(), ClientError> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}  {}", info.id, info.name.as_deref().unwrap_or(""))?;
    let stage = info.stage.as_ref();
    let progress = stage.map(|stage| format!(" ({stage} {:.0} %)", 100.0 * info.progress));
    writeln!(out, "state        {}{}", name_of(&info.state), progress.unwrap_or_default())?;
    if let Some(problem) = &info.error {
        writeln!(out, "error        {}", problem.detail)?;
    }
    writeln!(out, "generation   {}", info.generation)?;
    writeln!(
        out,
        "mesh         {} vertices, {} tets, {} domains, {} components",
        info.n_vertices, info.n_tets, info.n_domains, info.n_components
    )?;
    writeln!(
        out,
        "body         {} free dofs, {} rigid modes, {} elastic modes, {} basis columns",
        info.n_free_dofs, info.n_rigid_modes, info.n_modes, info.basis_size
    )?;
    writeln!(out, "stitches     {}", info.n_stitches)?;
    writeln!(out, "frequencies  {} Hz", hertz(&info.frequencies_hz))?;
    writeln!(out, "memory       {:.1} MiB", info.memory_bytes as f64 / f64::from(1 << 20))?;
    for warning in &info.warnings {
        writeln!(out, "warning      {warning}")?;
    }
    Ok(())
}

fn print_reply(reply: &EditReply) -> Result<(), ClientError> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "generation   {} by {} in {:.1} ms",
        reply.generation,
        name_of(&reply.method),
        reply.timings_ms.total
    )?;
    let names: Vec<String> = reply.stitch_ids.iter().map(u64::to_string).collect();
    writeln!(out, "new          stitches {}", names.join(" "))?;
    writeln!(out, "stitches     {}", reply.n_stitches)?;
    writeln!(out, "frequencies  {} Hz", hertz(&reply.frequencies_hz))?;
    let certificate = &reply.certificate;
    writeln!(
        out,
        "certificate  {}{}; eigenvalues within {:.0e} (lower half) and {:.0e} (upper half)",
        name_of(&certificate.verdict),
        if certificate.is_unfinished { ", to be finished" } else { "" },
        certificate.lower_eigenvalue_error,
        certificate.upper_eigenvalue_error,
    )?;
    for warning in &reply.warnings {
        writeln!(out, "warning      {warning}")?;
    }
    Ok(())
}

fn print_event(event: &Event) -> Result<(), ClientError> {
    let mut out = std::io::stdout().lock();
    match event {
        Event::State { state, generation } => {
            writeln!(out, "{} at generation {generation}", name_of(state))?;
        }
        Event::Stage { stage, progress } => writeln!(out, "{stage} {:.0} %", 100.0 * progress)?,
        Event::Generation(made) => writeln!(
            out,
            "generation {}: {} stitches, {} modes, {} basis columns",
            made.generation, made.n_stitches, made.n_modes, made.basis_size
        )?,
        Event::Simulation { running: true } => writeln!(out, "simulation started")?,
        Event::Simulation { running: false } => writeln!(out, "simulation stopped")?,
        Event::Failed { error } => writeln!(out, "failed: {}", error.detail)?,
        Event::Deleted => writeln!(out, "deleted")?,
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_is_two_vertices() {
        assert_eq!(pair("17,4021"), Ok([17, 4021]));
        for text in ["", "17", "17,", "17,-1", "17,18,19", "a,b"] {
            assert!(pair(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn a_file_of_pairs_is_read_or_refused_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pairs.json");
        std::fs::write(&path, "[[1, 2], [3, 4]]").unwrap();
        assert_eq!(read_json::<Vec<[u32; 2]>>(&path).unwrap(), [[1, 2], [3, 4]]);
        std::fs::write(&path, "[[1, 2],\n [3]]").unwrap();
        let error = read_json::<Vec<[u32; 2]>>(&path).unwrap_err();
        assert!(error.is_bad_input());
        let message = error.to_string();
        assert!(message.contains("pairs.json") && message.contains("line 2"), "{message}");
    }
}
