//! Bodies in the formats of other tools: NumPy's .npy, VTK's .vtu and .pvd, glTF's .glb with morph
//! targets, Vega's .U and .Ulin, and pictures.

mod error;
mod glb;
mod matrix;
mod motion;
mod shown;
mod vtu;

pub(crate) use error::ExportError;
pub(crate) use motion::Recording;

use clap::ValueEnum;
use glb::{Animation, Scene, Target};
use serde::Serialize;
use shown::Shown;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use sutura_client::proto::array::{Array, Data};
use sutura_client::proto::npy;
use sutura_core::mesh::TetMesh;
use sutura_picture::{Album, Picture};
use vtu::Grid;

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Arrays for NumPy: positions, tets, mass, modes, basis, frequencies.
    Npy,
    /// Modes for ParaView: modes.vtu.
    Vtu,
    /// Modes that swing, for viewers of glTF: modes.glb.
    Glb,
    /// Matrices for Vega: modes.Ulin, basis.U.
    Vega,
    /// Pictures of the lowest modes.
    Png,
}

/// A prepared body.
pub(crate) struct Body {
    pub(crate) name: String,
    pub(crate) mesh: TetMesh,
    /// Whether the mesh's labels are the user's.
    pub(crate) has_labels: bool,
    /// In kg, one for each vertex.
    pub(crate) mass_kg: Vec<f64>,
    pub(crate) frequencies_hz: Vec<f64>,
    /// Mass-normalised.
    pub(crate) modes: Columns,
    /// UᵀMU = 1.
    pub(crate) basis: Columns,
}

/// Vectors over the vertices, one after the other, `n_vertices × 3` each.
pub(crate) struct Columns {
    n_vertices: usize,
    data: Vec<f64>,
}

impl Columns {
    /// `data` is a whole number of columns.
    pub(crate) fn new(n_vertices: usize, data: Vec<f64>) -> Columns {
        Columns { n_vertices, data }
    }

    fn columns(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.data.chunks_exact(3 * self.n_vertices)
    }

    fn array<'a>(&'a self, name: &'static str) -> Array<'a> {
        let n = self.columns().len();
        Array::f64(name, [n, self.n_vertices, 3], self.data.as_slice())
    }
}

/// A file that was written.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Written {
    pub(crate) path: PathBuf,
    /// What is in it.
    pub(crate) what: String,
}

/// Modes that are drawn unless said otherwise.
pub(crate) const N_PICTURES: usize = 6;

/// Writes `body` into `folder`, which is made if it is not there.
pub(crate) fn write(
    body: &Body,
    folder: &Path,
    formats: &[Format],
    n_pictures: usize,
) -> Result<Vec<Written>, ExportError> {
    std::fs::create_dir_all(folder).map_err(ExportError::at(folder))?;
    let mut written = Vec::new();
    for format in Format::value_variants().iter().filter(|format| formats.contains(format)) {
        match format {
            Format::Npy => write_npy(body, folder, &mut written)?,
            Format::Vtu => write_vtu(body, folder, &mut written)?,
            Format::Glb => write_glb(body, folder, &mut written)?,
            Format::Vega => write_vega(body, folder, &mut written)?,
            Format::Png => write_pictures(body, folder, n_pictures, &mut written)?,
        }
    }
    Ok(written)
}

/// Makes the file `name` in `folder` by `fill`.
fn file(
    folder: &Path,
    name: &str,
    what: String,
    written: &mut Vec<Written>,
    fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), ExportError> {
    let path = folder.join(name);
    let make = || {
        let mut file = BufWriter::new(File::create(&path)?);
        fill(&mut file)?;
        file.flush()
    };
    make().map_err(ExportError::at(&path))?;
    written.push(Written { path, what });
    Ok(())
}

fn write_npy(body: &Body, folder: &Path, written: &mut Vec<Written>) -> Result<(), ExportError> {
    let n_vertices = body.mesh.vertices().len();
    let positions = body.mesh.vertices().as_flattened();
    let tets = body.mesh.tets().as_flattened();
    let frequencies = body.frequencies_hz.as_slice();
    let arrays = [
        Array::f64("positions", [n_vertices, 3], positions),
        Array::u32("tets", [tets.len() / 4, 4], tets),
        Array::f64("mass", [n_vertices], body.mass_kg.as_slice()),
        body.modes.array("modes"),
        body.basis.array("basis"),
        Array::f64("frequencies_hz", [frequencies.len()], frequencies),
    ];
    for array in &arrays {
        let shape: Vec<String> = array.shape.iter().map(usize::to_string).collect();
        let comma = if shape.len() == 1 { "," } else { "" };
        let kind = if matches!(array.data, Data::U32(_)) { "uint32" } else { "float64" };
        let what = format!("{kind}, ({}{comma})", shape.join(", "));
        let bytes = npy::encode(array).map_err(|error| ExportError::Unfit(error.to_string()))?;
        let name = format!("{}.npy", array.name);
        file(folder, &name, what, written, |file| file.write_all(&bytes))?;
    }
    Ok(())
}

/// The name of mode `i` with its frequency, for people.
fn title(body: &Body, i: usize) -> String {
    match body.frequencies_hz.get(i) {
        Some(frequency) => format!("mode {} ({frequency:.4} Hz)", i + 1),
        None => format!("mode {}", i + 1),
    }
}

fn write_vtu(body: &Body, folder: &Path, written: &mut Vec<Written>) -> Result<(), ExportError> {
    let vectors: Vec<(String, &[f64])> =
        body.modes.columns().enumerate().map(|(i, mode)| (title(body, i), mode)).collect();
    let what = format!("{} modes as vectors at the points: warp by one of them", vectors.len());
    let grid = Grid {
        points: body.mesh.vertices(),
        tets: body.mesh.tets(),
        labels: body.has_labels.then(|| body.mesh.labels()),
        vectors: &vectors,
    };
    file(folder, "modes.vtu", what, written, |file| grid.write(file))
}

fn write_glb(body: &Body, folder: &Path, written: &mut Vec<Written>) -> Result<(), ExportError> {
    let shown = Shown::of(&body.mesh);
    let targets: Vec<Target> = body
        .modes
        .columns()
        .enumerate()
        .map(|(i, mode)| {
            let scale = shown.scale(mode);
            Target { name: title(body, i), offsets: shown.pick(mode, scale) }
        })
        .collect();
    let animations = (0..targets.len())
        .map(|i| {
            let frequency = body.frequencies_hz.get(i).copied().unwrap_or(1.0);
            Animation::swinging(targets[i].name.clone(), i, targets.len(), frequency)
        })
        .collect();
    let what = format!("{} modes as morph targets, an animation for each", targets.len());
    let scene = Scene {
        name: &body.name,
        positions: shown.positions(),
        normals: shown.normals(),
        triangles: shown.triangles(),
        targets,
        animations,
    };
    let bytes = scene.encode()?;
    file(folder, "modes.glb", what, written, |file| file.write_all(&bytes))
}

fn write_vega(body: &Body, folder: &Path, written: &mut Vec<Written>) -> Result<(), ExportError> {
    for (name, columns, what) in
        [("modes.Ulin", &body.modes, "linear modes"), ("basis.U", &body.basis, "basis")]
    {
        let (rows, n) = (3 * body.mesh.vertices().len(), columns.columns().len());
        let header = matrix::header(rows, n)?;
        let what = format!("{what}, {rows} × {n}, Vega's matrix format");
        file(folder, name, what, written, |file| {
            file.write_all(&header)?;
            columns.data.iter().try_for_each(|x| file.write_all(&x.to_le_bytes()))
        })?;
    }
    Ok(())
}

fn write_pictures(
    body: &Body,
    folder: &Path,
    n_pictures: usize,
    written: &mut Vec<Written>,
) -> Result<(), ExportError> {
    let shown = Shown::of(&body.mesh);
    let modes: Vec<Vec<f32>> = body
        .modes
        .columns()
        .take(n_pictures)
        .map(|mode| {
            let scale = shown.scale(mode);
            mode.iter().map(|x| (scale * x) as f32).collect()
        })
        .collect();
    let views: Vec<&[f32]> = modes.iter().map(Vec::as_slice).collect();
    let album = Album::new(body.mesh.vertices(), body.mesh.tets(), &[], &views);
    for (i, displacement) in views.iter().enumerate() {
        let heading = format!("{}, {}", body.name, title(body, i));
        let picture = Picture {
            title: &heading,
            caption: "Linear mode, its amplitude a tenth of the body's diagonal.",
            displacement,
            stitches: &[],
        };
        let name = format!("mode_{:02}.png", i + 1);
        file(folder, &name, title(body, i), written, |file| {
            album.write(&picture, file).map_err(std::io::Error::other)
        })?;
    }
    Ok(())
}
