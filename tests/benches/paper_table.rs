//! The tables and figures of \[M16\] on bodies of its sizes, the core's stages beside its peers', and
//! what makes them trustworthy: see README.md. `cargo bench --bench paper_table -- --help`

mod accuracy;
mod accuracy_report;
mod bodies;
mod chart;
mod clock;
mod cubature;
mod edits;
mod kernels;
mod loads;
mod measure;
mod paper;
mod peers;
mod pictures;
mod reduced;
mod references;
mod report;
mod results;
mod scaling;
mod session;
mod training;

use bodies::Failure;
use clap::Parser;
use measure::Check;
use results::{Part, Plan};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// The daemon's.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Measures the numerical core and writes paper_table.json, paper_table.md and pictures.
#[derive(Parser)]
struct Arguments {
    /// Folder of NAME.msh and NAME.json; the repository's own small bodies by default.
    #[arg(long)]
    meshes: Option<PathBuf>,
    /// Folder of frequencies to agree with: NAME.reference.json or NAME.json.
    #[arg(long)]
    references: Option<PathBuf>,
    /// Names of bodies, separated by commas.
    #[arg(long, value_delimiter = ',')]
    bodies: Vec<String>,
    /// Repetitions of everything.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    repeat: u16,
    /// Most stitches of an edit; with --accuracy, of a body's own, spread over all, which are the seam.
    #[arg(long, default_value_t = 160)]
    stitches: usize,
    /// Vertices of the largest cube; 0 leaves the cubes out.
    #[arg(long)]
    cubes: Option<usize>,
    /// Compare the methods that select cubature points as well: 20 builds a body.
    #[arg(long)]
    cubature: bool,
    /// Write the equations that each body's cubature points are selected from to this folder, instead.
    #[arg(long, value_name = "FOLDER")]
    training: Option<PathBuf>,
    /// With --training: of each body closed by all of its own stitches.
    #[arg(long, requires = "training")]
    closed: bool,
    /// How good rebuilt bases are, instead of what they take: accuracy.json, accuracy.md and a picture.
    #[arg(long)]
    accuracy: bool,
    /// What the reduced model of the first body takes to evaluate and to step, instead: so many steps of 1 ms
    /// under random pulls for each material law.
    #[arg(long, value_name = "STEPS")]
    reduced: Option<usize>,
    /// A Python interpreter with what peers/requirements.txt names: runs peers/peers.py beside each body.
    #[arg(long, value_name = "PYTHON")]
    peers: Option<PathBuf>,
    /// Where the results go.
    #[arg(long, default_value = "target/paper_table")]
    out: PathBuf,
    /// Do one part only and print it: how the program calls itself.
    #[arg(long, hide = true)]
    child: Option<Part>,
    /// Cargo's own flag.
    #[arg(long, hide = true)]
    bench: bool,
}

impl Arguments {
    fn plan(&self) -> Plan {
        let own = bodies::default_directory();
        let names: &[&str] = match self.meshes {
            None => &["stomach_small", "plant_small", "fork_small"],
            Some(_) => &["stomach", "plant", "fork", "dinosaur", "oball"],
        };
        let references = match self.meshes {
            None => self.references.clone().or_else(|| Some(own.join("reference"))),
            Some(_) => self.references.clone(),
        };
        let largest = if self.meshes.is_some() { 60_000 } else { 10_000 };
        Plan {
            references,
            bodies: match self.bodies.is_empty() {
                true => names.iter().map(|name| (*name).to_owned()).collect(),
                false => self.bodies.clone(),
            },
            meshes: self.meshes.clone().unwrap_or(own),
            repeat: self.repeat.into(),
            most_stitches: self.stitches,
            most_cube_vertices: self.cubes.unwrap_or(largest),
            compares_cubature: self.cubature,
            is_apart: true,
        }
    }
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<ExitCode, Failure> {
    let plan = arguments.plan();
    if let Some(part) = arguments.child {
        let name = plan.bodies.first().ok_or("which body?")?;
        let answer = plan.part(part, name)?;
        serde_json::to_writer(std::io::stdout().lock(), &answer)?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(folder) = &arguments.training {
        for name in &plan.bodies {
            training::export(&bodies::Body::load(&plan.meshes, name)?, arguments.closed, folder)?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(n_steps) = arguments.reduced {
        let name = plan.bodies.first().ok_or("which body?")?;
        let body = bodies::Body::load(&plan.meshes, name)?;
        reduced::run(&body, n_steps, &mut std::io::stdout().lock())?;
        return Ok(ExitCode::SUCCESS);
    }
    std::fs::create_dir_all(&arguments.out)?;
    let at = |name: &str| arguments.out.join(name);
    if arguments.accuracy {
        let results = plan.run_accuracy()?;
        let pictures = pictures::draw_accuracy(&results, &arguments.out)?;
        let text = accuracy_report::markdown(&results, &pictures);
        std::fs::write(at("accuracy.json"), serde_json::to_vec_pretty(&results)?)?;
        std::fs::write(at("accuracy.md"), &text)?;
        return conclude(&text, &results.wrong());
    }
    let results = plan.run(arguments.peers.as_deref(), &arguments.out)?;
    let pictures = pictures::draw(&results, &arguments.out)?;
    let text = report::markdown(&results, &pictures);
    std::fs::write(at("paper_table.json"), serde_json::to_vec_pretty(&results)?)?;
    std::fs::write(at("paper_table.md"), &text)?;
    conclude(&text, &results.wrong())
}

/// Shows the results; what is wrong decides how the program ends.
fn conclude(text: &str, wrong: &[&(String, Check)]) -> Result<ExitCode, Failure> {
    std::io::stdout().lock().write_all(text.as_bytes())?;
    for (body, check) in wrong {
        eprintln!("wrong: {body}: {}: {:e} > {:e}", check.what, check.value, check.limit);
    }
    Ok(if wrong.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
