//! VTK files of unstructured grids: [`legacy`] .vtk (text and binary, versions 1 to 5.1) and [`xml`]
//! .vtu (text, inline base64, appended base64 or raw; plain or zlib). Source: "VTK File Formats"
//! in the VTK user's guide, and vtkXMLDataParser.cxx where that is silent.
//!
//! Four-node tetrahedra are kept; vertices, lines and surface cells are skipped; any other cell fills
//! volume and is refused, since leaving it out would change the body. A tet's domain is the integer of
//! the first cell array whose name is among [`LABEL_NAMES`].

mod data;
mod legacy;
mod scalar;
mod xml;

pub(super) use legacy::read as read_legacy;
pub(super) use xml::read as read_xml;

use super::TetMesh;
use super::cursor::Cursor;
use super::reader::{MeshLimits, ReadError, ReadFault, validate};
use scalar::{Numbers, Scalar};

/// What writers call the domain of a cell, in any case of letters; the first one a file has is taken.
const LABEL_NAMES: [&str; 11] = [
    "domain",
    "domains",
    "region",
    "material",
    "label",
    "gmsh:physical",
    "gmsh:geometrical",
    "medit:ref",
    "tetgen:ref",
    "CellEntityIds",
    "MaterialIds",
];

/// Cells of any kind accepted for each tet that is.
const MAX_CELLS_PER_TET: usize = 8;
/// Most corners of a cell of any kind, on average.
const MAX_CORNERS_PER_CELL: usize = 8;

const TETRA: i64 = 10;

/// Whether a cell of this type fills no volume: points, lines, surfaces.
fn is_skipped(cell_type: i64) -> bool {
    matches!(cell_type, 0..=9 | 21..=23 | 28 | 30 | 34..=36 | 68..=70 | 75..=77)
}

fn max_cells(limits: &MeshLimits) -> usize {
    limits.max_tets.saturating_mul(MAX_CELLS_PER_TET)
}

fn max_corners(limits: &MeshLimits) -> usize {
    max_cells(limits).saturating_mul(MAX_CORNERS_PER_CELL)
}

/// The place of a name among [`LABEL_NAMES`].
fn label_rank(name: &str) -> Option<usize> {
    LABEL_NAMES.iter().position(|known| known.eq_ignore_ascii_case(name))
}

/// An array of the file and where it stands.
struct Located<T> {
    at: usize,
    values: T,
}

/// A grid as the file tells it.
struct Grid {
    points: Located<Vec<[f64; 3]>>,
    /// Where the corners of each cell end.
    offsets: Located<Vec<i64>>,
    /// The corners of all cells.
    corners: Located<Vec<i64>>,
    types: Located<Vec<i64>>,
    /// One number for each cell.
    labels: Option<Located<Numbers>>,
}

impl Grid {
    fn into_mesh(self, cursor: &Cursor<'_>, limits: &MeshLimits) -> Result<TetMesh, ReadError> {
        let inconsistent = |at, message| Err(cursor.error(at, ReadFault::Inconsistent(message)));
        let n_cells = self.types.values.len();
        if self.offsets.values.len() != n_cells {
            let message = format!("{} offsets for {n_cells} cell types", self.offsets.values.len());
            return inconsistent(self.offsets.at, message);
        }
        if let Some(labels) = &self.labels
            && labels.values.len() != n_cells
        {
            let message = format!("{} labels for {n_cells} cells", labels.values.len());
            return inconsistent(labels.at, message);
        }
        let n_points = self.points.values.len();
        let (mut tets, mut cell_of_tet, mut labels) = (Vec::new(), Vec::new(), Vec::new());
        let mut start = 0;
        for (cell, (&end, &cell_type)) in
            self.offsets.values.iter().zip(&self.types.values).enumerate()
        {
            let range = usize::try_from(end).ok().filter(|&end| start <= end);
            let Some((end, corners)) =
                range.and_then(|end| Some((end, self.corners.values.get(start..end)?)))
            else {
                let message = format!(
                    "cell {cell}: its corners end at {end} of {}, after {start}",
                    self.corners.values.len()
                );
                return inconsistent(self.offsets.at, message);
            };
            start = end;
            if is_skipped(cell_type) {
                continue;
            }
            if cell_type != TETRA {
                let message = format!(
                    "cell {cell} is of type {cell_type}: of the cells that fill volume only tetrahedra \
                     of four nodes (type {TETRA}) are supported"
                );
                return Err(cursor.error(self.types.at, ReadFault::Unsupported(message)));
            }
            let Ok(corners) = <[i64; 4]>::try_from(corners) else {
                let message = format!("cell {cell}: a tetrahedron of {} corners", corners.len());
                return inconsistent(self.corners.at, message);
            };
            if let Some(corner) = corners.iter().find(|c| !(0..n_points as i64).contains(c)) {
                let message = format!("cell {cell}: point {corner} is not among the {n_points}");
                return inconsistent(self.corners.at, message);
            }
            cursor.check_limit("tets", tets.len() as u64 + 1, limits.max_tets)?;
            tets.push(corners.map(|corner| corner as u32));
            cell_of_tet.push(cell as u64);
            if let Some(array) = &self.labels {
                let Some(label) = array.values.integer(cell) else {
                    let message = format!("cell {cell}: its label is not an integer");
                    return inconsistent(array.at, message);
                };
                labels.push(label);
            }
        }
        validate(
            cursor,
            self.points.values,
            tets,
            labels,
            |vertex| (vertex as u64, self.points.at),
            |tet| (cell_of_tet[tet], self.corners.at),
        )
    }
}

/// Triples of coordinates.
fn points(
    cursor: &Cursor<'_>,
    at: usize,
    numbers: &Numbers,
) -> Result<Located<Vec<[f64; 3]>>, ReadError> {
    let reals = numbers.reals();
    let (triples, rest) = reals.as_chunks();
    if !rest.is_empty() {
        let message = format!("{} coordinates are not triples", reals.len());
        return Err(cursor.error(at, ReadFault::Inconsistent(message)));
    }
    Ok(Located { at, values: triples.to_vec() })
}

/// Integers that must not be reals.
fn integers(
    cursor: &Cursor<'_>,
    at: usize,
    numbers: Numbers,
) -> Result<Located<Vec<i64>>, ReadError> {
    match numbers {
        Numbers::Integers(values) => Ok(Located { at, values }),
        Numbers::Reals(_) => {
            let message = "numbers of cells must be integers".to_owned();
            Err(cursor.error(at, ReadFault::Inconsistent(message)))
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
