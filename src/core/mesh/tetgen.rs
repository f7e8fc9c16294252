//! TetGen's meshes: a .node and an .ele file (text). Source: TetGen user's manual, "File formats".
//!
//! ```text
//! n 3 n_attributes n_markers        n 4 n_attributes
//! 1 x y z … …                       1 a b c d …
//! ```
//! The first node says whether everything is numbered from 0 or from 1. A tet's domain is its first
//! attribute, the region. `#` starts a comment.

use super::TetMesh;
use super::cursor::Cursor;
use super::line;
use super::reader::{MeshLimits, ReadError, ReadFault, validate};

/// The shortest node and tet, line end included: `1 0 0 0`.
const MIN_RECORD: u64 = 8;

/// Reads the bytes of both files.
pub(super) fn read(nodes: &[u8], tets: &[u8], limits: &MeshLimits) -> Result<TetMesh, ReadError> {
    let mut node_file = Cursor::part(nodes, ".node");
    let (first, vertices, vertices_at) = read_nodes(&mut node_file, limits)?;
    let mut tet_file = Cursor::part(tets, ".ele");
    let header = line::required(&mut tet_file, "the number of tets")?;
    let n: u64 = header.number(&tet_file, 0, "the number of tets")?;
    let n_corners: u64 = header.number(&tet_file, 1, "4 nodes a tet")?;
    if n_corners != 4 {
        let message = format!("tets of {n_corners} nodes are not supported, only of 4");
        return Err(tet_file.error(header.at, ReadFault::Unsupported(message)));
    }
    let n_attributes: u64 = match header.fields.len() {
        0..=2 => 0,
        _ => header.number(&tet_file, 2, "the number of attributes")?,
    };
    tet_file.check_limit("tets", n, limits.max_tets)?;
    tet_file.check_room("tets", n, MIN_RECORD)?;
    let mut first_tet = first;
    let (mut corners, mut at, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    for position in 0..n {
        let line = line::required(&mut tet_file, "a tet")?;
        line.check_number(&tet_file, "the tet's number", position, &mut first_tet)?;
        let number = first_tet + position;
        let mut tet = [0; 4];
        for (field, corner) in tet.iter_mut().enumerate() {
            let tag: u64 = line.number(&tet_file, field + 1, "a node")?;
            let vertex = tag.checked_sub(first).filter(|&vertex| vertex < vertices.len() as u64);
            *corner = vertex.ok_or_else(|| {
                let message = format!(
                    "tet {number}: node {tag} is not among the {} of the .node file",
                    vertices.len()
                );
                tet_file.error(line.at, ReadFault::Inconsistent(message))
            })? as u32;
        }
        if n_attributes > 0 {
            let label: f64 = line.number(&tet_file, 5, "the tet's region")?;
            if label as i64 as f64 != label {
                let message = format!("tet {number}: its region {label} is not an integer");
                return Err(tet_file.error(line.at, ReadFault::Inconsistent(message)));
            }
            labels.push(label as i64);
        }
        corners.push(tet);
        at.push(line.at);
    }
    if let Some(line) = line::next(&mut tet_file)? {
        return Err(tet_file.unexpected(line.at, "the end of the file"));
    }
    let finite = vertices.iter().position(|x| x.iter().any(|c| !c.is_finite()));
    // A node's fault stands in the other file than a tet's.
    if let Some(vertex) = finite {
        let message = format!("node {}: a coordinate is not finite", first + vertex as u64);
        return Err(node_file.error(vertices_at[vertex], ReadFault::Inconsistent(message)));
    }
    validate(
        &tet_file,
        vertices,
        corners,
        labels,
        |vertex| (first + vertex as u64, 0),
        |tet| (first_tet + tet as u64, at[tet]),
    )
}

/// The number of the first node, the nodes, and where each stands.
type Nodes = (u64, Vec<[f64; 3]>, Vec<usize>);

fn read_nodes(cursor: &mut Cursor<'_>, limits: &MeshLimits) -> Result<Nodes, ReadError> {
    let header = line::required(cursor, "the number of nodes")?;
    let n: u64 = header.number(cursor, 0, "the number of nodes")?;
    if header.number::<u64>(cursor, 1, "the dimension 3")? != 3 {
        let message = "nodes must have dimension 3".into();
        return Err(cursor.error(header.at, ReadFault::Unsupported(message)));
    }
    cursor.check_limit("nodes", n, limits.max_vertices)?;
    cursor.check_room("nodes", n, MIN_RECORD)?;
    let (mut first, mut vertices, mut at) = (0, Vec::new(), Vec::new());
    for position in 0..n {
        let line = line::required(cursor, "a node")?;
        line.check_number(cursor, "the node's number", position, &mut first)?;
        let mut x = [0.0; 3];
        for (axis, coordinate) in x.iter_mut().enumerate() {
            *coordinate = line.number(cursor, axis + 1, "a coordinate")?;
        }
        vertices.push(x);
        at.push(line.at);
    }
    if let Some(line) = line::next(cursor)? {
        return Err(cursor.unexpected(line.at, "the end of the file"));
    }
    Ok((first, vertices, at))
}

#[cfg(test)]
mod tests;
