//! The entry to the mesh readers: bytes of files in ([`read_files`]), a valid [`TetMesh`] out.
//!
//! A file's vertices keep their order of appearance and are numbered from zero; its own node
//! numbers, which may be sparse, appear in error messages only. Nothing is allocated for a count
//! that the file declares before it has been held against the limits and against the bytes left.

use super::cursor::Cursor;
use super::{MeshError, TetMesh, gmsh, tetgen, vega, vtk};
use crate::material::{Material, MaterialError};
use std::collections::BTreeMap;
use std::fmt;

/// The mesh formats that [`read`] understands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Gmsh .msh: format 2 and 4.1, text or binary of either byte order, and format 1 (text).
    Gmsh,
    /// Vega .veg: tetrahedral, text.
    Vega,
    /// VTK's legacy .vtk: unstructured grids, text or binary, up to version 5.1.
    VtkLegacy,
    /// VTK's XML .vtu: text, inline base64 or appended; plain or zlib.
    VtkXml,
}

impl MeshFormat {
    /// The format that a file name's extension stands for, in any case of letters.
    pub fn from_file_name(name: &str) -> Option<MeshFormat> {
        match name.rsplit_once('.')?.1.to_ascii_lowercase().as_str() {
            "msh" => Some(MeshFormat::Gmsh),
            "veg" => Some(MeshFormat::Vega),
            "vtk" => Some(MeshFormat::VtkLegacy),
            "vtu" => Some(MeshFormat::VtkXml),
            _ => None,
        }
    }

    /// The format that a file's first bytes look like: `$MeshFormat`, `<VTKFile`, `# vtk DataFile`, or
    /// another comment or `*VERTICES`.
    pub fn sniff(bytes: &[u8]) -> Option<MeshFormat> {
        let bytes = bytes.trim_ascii_start();
        match bytes.first()? {
            b'$' => Some(MeshFormat::Gmsh),
            b'<' => Some(MeshFormat::VtkXml),
            b'#' if bytes.starts_with(b"# vtk DataFile") => Some(MeshFormat::VtkLegacy),
            b'#' | b'*' => Some(MeshFormat::Vega),
            _ => None,
        }
    }
}

/// The largest mesh accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshLimits {
    /// Most vertices.
    pub max_vertices: usize,
    /// Most tetrahedra.
    pub max_tets: usize,
}

/// What a mesh file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshFile {
    /// The mesh.
    pub mesh: TetMesh,
    /// The material of each domain label, where the format carries materials (Vega).
    pub materials: BTreeMap<i64, Material>,
}

/// Where in a file a fault lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// A line of a text file, from 1.
    Line(usize),
    /// An offset into a binary file, from 0.
    Byte(usize),
    /// A line, from 1, of one of several text files, which the name says.
    PartLine(&'static str, usize),
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Location::Line(line) => write!(f, "line {line}"),
            Location::Byte(offset) => write!(f, "byte {offset}"),
            Location::PartLine(part, line) => write!(f, "{part} file, line {line}"),
        }
    }
}

/// Why a file could not be read, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{location}: {fault}")]
pub struct ReadError {
    /// Where reading stopped, or where the offending node or element stands.
    pub location: Location,
    /// What is wrong there.
    pub fault: ReadFault,
}

/// What is wrong with a file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum ReadFault {
    #[error("expected {expected}, found {found}")]
    Unexpected { expected: String, found: String },
    #[error("{0}")]
    Unsupported(String),
    #[error("{0}")]
    Inconsistent(String),
    #[error("{declared} {what} declared, at most {limit} are accepted")]
    OverLimit { what: &'static str, declared: u64, limit: u64 },
    #[error("{declared} {what} declared, but only {remaining} bytes follow")]
    Truncated { what: &'static str, declared: u64, remaining: usize },
    /// `item` names the node or element as the file numbers it; the error's own indices are those
    /// of the mesh, from zero.
    #[error("{item}: {error}")]
    Mesh { item: String, error: MeshError },
    #[error("material {name}: {error}")]
    Material { name: String, error: MaterialError },
}

/// Reads the bytes of a mesh file.
pub fn read(bytes: &[u8], format: MeshFormat, limits: &MeshLimits) -> Result<MeshFile, ReadError> {
    let without_materials = |mesh| MeshFile { mesh, materials: BTreeMap::new() };
    match format {
        MeshFormat::Gmsh => gmsh::read(bytes, limits).map(without_materials),
        MeshFormat::Vega => vega::read(bytes, limits),
        MeshFormat::VtkLegacy => vtk::read_legacy(bytes, limits).map(without_materials),
        MeshFormat::VtkXml => vtk::read_xml(bytes, limits).map(without_materials),
    }
}

/// A file as its sender calls it.
#[derive(Clone, Copy, Debug)]
pub struct NamedFile<'a> {
    /// Its name, if it has one.
    pub name: Option<&'a str>,
    /// All of it.
    pub bytes: &'a [u8],
}

impl NamedFile<'_> {
    fn is_called(&self, extension: &str) -> bool {
        let found = self.name.and_then(|name| name.rsplit_once('.'));
        found.is_some_and(|(_, found)| found.eq_ignore_ascii_case(extension))
    }
}

/// Why files are no mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SourceError {
    /// What the files are cannot be told.
    #[error(
        "neither the name nor the first bytes are those of a mesh file: Gmsh .msh, VTK .vtk or .vtu, Vega \
         .veg, TetGen .node and .ele"
    )]
    Unknown,
    /// TetGen's meshes are two files.
    #[error("a TetGen mesh is two files: send the .node and the .ele file")]
    HalfTetGen,
    /// Several files that do not belong together.
    #[error("only a TetGen mesh is two files, .node and .ele; others are one")]
    TooManyFiles,
    /// They cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// Reads a mesh from its file, or from TetGen's two in either order. The name decides the format; without
/// a telling one the first bytes do.
pub fn read_files(files: &[NamedFile<'_>], limits: &MeshLimits) -> Result<MeshFile, SourceError> {
    match files {
        [file] => {
            if file.is_called("node") || file.is_called("ele") {
                return Err(SourceError::HalfTetGen);
            }
            let named = file.name.and_then(MeshFormat::from_file_name);
            let format = named.or_else(|| MeshFormat::sniff(file.bytes));
            Ok(read(file.bytes, format.ok_or(SourceError::Unknown)?, limits)?)
        }
        [a, b] => {
            let [nodes, tets] = if a.is_called("node") { [a, b] } else { [b, a] };
            if !(nodes.is_called("node") && tets.is_called("ele")) {
                return Err(SourceError::TooManyFiles);
            }
            let mesh = tetgen::read(nodes.bytes, tets.bytes, limits)?;
            Ok(MeshFile { mesh, materials: BTreeMap::new() })
        }
        [] => Err(SourceError::Unknown),
        _ => Err(SourceError::TooManyFiles),
    }
}

/// Validates what a reader has collected. `node` and `element` tell, for a zero-based vertex or tet,
/// what the file calls it and at which position it stands.
pub(super) fn validate(
    cursor: &Cursor<'_>,
    vertices: Vec<[f64; 3]>,
    tets: Vec<[u32; 4]>,
    labels: Vec<i64>,
    node: impl Fn(usize) -> (u64, usize),
    element: impl Fn(usize) -> (u64, usize),
) -> Result<TetMesh, ReadError> {
    TetMesh::new(vertices, tets, labels).map_err(|error| {
        let (item, position) = match error {
            MeshError::NonFinite { vertex, .. } => {
                let (tag, position) = node(vertex);
                (format!("node {tag}"), position)
            }
            MeshError::VertexOutOfRange { tet, .. }
            | MeshError::RepeatedVertex { tet, .. }
            | MeshError::Inverted { tet, .. }
            | MeshError::Flat { tet, .. } => {
                let (number, position) = element(tet);
                (format!("element {number}"), position)
            }
            MeshError::NoTets
            | MeshError::LabelCount { .. }
            | MeshError::TooManyVertices { .. } => ("whole file".into(), cursor.position()),
        };
        cursor.error(position, ReadFault::Mesh { item, error })
    })
}

#[cfg(test)]
mod tests;
