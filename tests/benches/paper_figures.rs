//! What \[M16\] shows in pictures, measured: figures 1, 4, 7, 9 and 11 (3 and 5 are `paper_table`'s).
//! `cargo bench --bench paper_figures -- --figure 4`; without a number, all of them.

mod bodies;
mod chart;
mod clock;
mod figures;

use bodies::{Body, Failure};
use clap::{Parser, ValueEnum};
use figures::{Figure, Scene};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// The daemon's.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Repeats the evidence of the paper's figures: data as JSON, charts and pictures of the bodies.
#[derive(Parser)]
struct Arguments {
    /// Which figure; all by default.
    #[arg(long, value_enum)]
    figure: Vec<Figure>,
    /// Folder of NAME.msh and NAME.json; the repository's own small bodies by default.
    #[arg(long)]
    meshes: Option<PathBuf>,
    /// Another body than the paper's.
    #[arg(long)]
    body: Option<String>,
    /// Frames of a motion.
    #[arg(long, default_value_t = 150, value_parser = clap::value_parser!(u32).range(2..))]
    frames: u32,
    /// Where the results go.
    #[arg(long, default_value = "target/paper_figures")]
    out: PathBuf,
    /// Cargo's own flag.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), Failure> {
    let figures = match arguments.figure.is_empty() {
        true => Figure::value_variants().to_vec(),
        false => arguments.figure.clone(),
    };
    let directory = arguments.meshes.clone().unwrap_or_else(bodies::default_directory);
    std::fs::create_dir_all(&arguments.out)?;
    for figure in figures {
        let own = figure.body(arguments.meshes.is_none());
        let body = Body::load(&directory, arguments.body.as_deref().unwrap_or(own))?;
        let scene = Scene::new(figure, &body, arguments.frames as usize, &arguments.out);
        let text = figure.show(&scene)?;
        std::io::stdout().lock().write_all(text.as_bytes())?;
    }
    Ok(())
}
