//! The equations that cubature points are selected from, for selections of others: `peers/kratos.py` reads them.

use crate::bodies::{Body, Failure};
use crate::clock::Clock;
use crate::cubature::{METHODS, NEVER, POINTS};
use crate::edits::TOLERANCE;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use sutura_core::build::{self, BuildParams, Examined, Method, RebuildParams};
use sutura_core::cubature::{Rule, Samples, Training, smooth, train};

/// Tets whose columns are held at a time.
const TETS_AT_A_TIME: usize = 512;

/// What is known of the held-out poses, and our rules.
#[derive(Serialize)]
struct Ours {
    n_held_out: usize,
    rules: Vec<Found>,
}

/// One rule of ours.
#[derive(Serialize)]
struct Found {
    method: &'static str,
    n_points: usize,
    /// Relative error on held-out poses, energy norm.
    error: f64,
}

/// Writes the equations of `body`'s training poses and of its held-out poses to `folder`, a row a tet and one for
/// their sum (.npy, single precision: files of half a gigabyte), and how far each method comes with them; with the body
/// closed by all of its own stitches if `is_closed`.
pub(crate) fn export(body: &Body, is_closed: bool, folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)?;
    let session = body.session(&[]);
    let cubature = session.cubature.ok_or("a session without cubature")?;
    let params = BuildParams { cubature: None, ..session };
    let mut made = build::build(body.mesh.clone(), &params, &Clock::start())?;
    if is_closed {
        let method = RebuildParams::new(Method::Flexibility, TOLERANCE);
        made = build::rebuild(&made, &body.stitch(&body.stitches), &method, &Clock::start())?.0;
    }
    let n_tets = body.mesh.tets().len();
    let examine = |poses: Examined<'_>| -> Result<(), Failure> {
        let Examined { training, more, held_out } = poses;
        for (name, samples) in [("training", &training), ("held_out", &held_out)] {
            let path = folder.join(format!("{}.{name}.npy", body.name));
            write(samples, n_tets, BufWriter::new(File::create(path)?))?;
        }
        let mut found = Vec::new();
        for (method, selection, smoothing) in METHODS {
            for n_points in POINTS {
                let seed = cubature.seed;
                let wanted = Training { selection, n_points, tolerance: NEVER, seed };
                let clock = Clock::start();
                let mut rule = train(&training, &wanted, &clock)?;
                if smoothing {
                    let (samples, more) = (training.clone(), || Ok(more.clone()));
                    let suffices = |rule: &Rule| held_out.error(rule) <= cubature.tolerance;
                    rule = smooth(rule, samples, more, NEVER, &suffices, &clock)?;
                }
                let error = held_out.error(&rule);
                found.push(Found { method, n_points: rule.tets.len(), error });
            }
        }
        let path = folder.join(format!("{}.ours.json", body.name));
        let ours = Ours { n_held_out: held_out.n_poses(), rules: found };
        Ok(std::fs::write(path, serde_json::to_vec_pretty(&ours)?)?)
    };
    build::examine_training(&made, &cubature, &Clock::start(), examine)?
}

/// NumPy's format, version 1.0.
fn write(samples: &Samples<'_>, n_tets: usize, mut to: impl Write) -> Result<(), Failure> {
    let (_, target) = samples.equations(&Rule::of_tets(Vec::new(), Vec::new()));
    let shape = format!("({}, {})", n_tets + 1, target.len());
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    // The data begin at a multiple of 64 bytes.
    let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
    to.write_all(b"\x93NUMPY\x01\x00")?;
    to.write_all(&u16::try_from(length)?.to_le_bytes())?;
    writeln!(to, "{header:width$}", width = length - 1)?;
    let all: Vec<u32> = (0..n_tets as u32).collect();
    for some in all.chunks(TETS_AT_A_TIME) {
        let rule = Rule::of_tets(some.to_vec(), vec![1.0; some.len()]);
        let (columns, _) = samples.equations(&rule);
        for column in 0..columns.ncols() {
            row(columns.col_as_slice(column), &mut to)?;
        }
    }
    row(&target, &mut to)
}

fn row(numbers: &[f64], to: &mut impl Write) -> Result<(), Failure> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect();
    Ok(to.write_all(&bytes)?)
}
