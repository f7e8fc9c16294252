//! The one entry to the mesh readers: bytes of a file in, a valid [`TetMesh`] out.
//!
//! A file's vertices keep their order of appearance and are numbered from zero; its own node
//! numbers, which may be sparse, appear in error messages only. Nothing is allocated for a count
//! that the file declares before it has been held against the limits and against the bytes left.

use super::cursor::Cursor;
use super::{MeshError, TetMesh, gmsh, vega};
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
}

impl MeshFormat {
    /// The format that a file name's extension stands for, in any case of letters.
    pub fn from_file_name(name: &str) -> Option<MeshFormat> {
        match name.rsplit_once('.')?.1.to_ascii_lowercase().as_str() {
            "msh" => Some(MeshFormat::Gmsh),
            "veg" => Some(MeshFormat::Vega),
            _ => None,
        }
    }

    /// The format that a file's first bytes look like: `$MeshFormat`, or a comment or `*VERTICES`.
    pub fn sniff(bytes: &[u8]) -> Option<MeshFormat> {
        match bytes.trim_ascii_start().first()? {
            b'$' => Some(MeshFormat::Gmsh),
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
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Location::Line(line) => write!(f, "line {line}"),
            Location::Byte(offset) => write!(f, "byte {offset}"),
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
    match format {
        MeshFormat::Gmsh => {
            gmsh::read(bytes, limits).map(|mesh| MeshFile { mesh, materials: BTreeMap::new() })
        }
        MeshFormat::Vega => vega::read(bytes, limits),
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
