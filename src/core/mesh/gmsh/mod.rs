//! Gmsh .msh files: format 2 ([`v2`], which also reads format 1) and format 4.1 ([`v4`]), in text
//! or in binary of either byte order. Source: Gmsh reference manual, "File formats".
//!
//! Four-node tetrahedra are kept; points, lines, triangles and quadrangles are skipped; any other
//! element that fills volume is refused, since leaving it out would change the body. A tet's domain
//! is its (first) physical group, or its elementary entity where it has none.

mod element_type;
mod v2;
mod v4;

use super::TetMesh;
use super::cursor::{Cursor, Encoding, quote};
use super::reader::{MeshLimits, ReadError, ReadFault, validate};

/// A mesh as the file tells it: corners by node tag.
#[derive(Default)]
struct Listing {
    vertices: Vec<[f64; 3]>,
    nodes: Vec<Node>,
    tets: Vec<Tet>,
}

struct Node {
    tag: u64,
    /// Position in the file.
    at: usize,
}

struct Tet {
    /// The element's number in the file.
    element: u64,
    corners: [u64; 4],
    label: i64,
    /// Position in the file.
    at: usize,
}

impl Listing {
    fn push_node(&mut self, tag: u64, at: usize, position: [f64; 3]) {
        self.nodes.push(Node { tag, at });
        self.vertices.push(position);
    }

    fn into_mesh(self, cursor: &Cursor<'_>) -> Result<TetMesh, ReadError> {
        let inconsistent = |at, message| cursor.error(at, ReadFault::Inconsistent(message));
        let mut vertex_of_tag: Vec<(u64, u32)> =
            self.nodes.iter().zip(0..).map(|(node, vertex)| (node.tag, vertex)).collect();
        vertex_of_tag.sort_unstable();
        for pair in vertex_of_tag.windows(2) {
            if pair[0].0 == pair[1].0 {
                let node = &self.nodes[pair[1].1 as usize];
                return Err(inconsistent(node.at, format!("node {} is defined twice", node.tag)));
            }
        }
        let mut tets = Vec::with_capacity(self.tets.len());
        for tet in &self.tets {
            let mut corners = [0; 4];
            for (corner, tag) in corners.iter_mut().zip(tet.corners) {
                let Ok(found) = vertex_of_tag.binary_search_by_key(&tag, |entry| entry.0) else {
                    let message = format!(
                        "element {}: node {tag} is not among the {} nodes",
                        tet.element,
                        self.nodes.len()
                    );
                    return Err(inconsistent(tet.at, message));
                };
                *corner = vertex_of_tag[found].1;
            }
            tets.push(corners);
        }
        let labels = self.tets.iter().map(|tet| tet.label).collect();
        validate(
            cursor,
            self.vertices,
            tets,
            labels,
            |vertex| (self.nodes[vertex].tag, self.nodes[vertex].at),
            |tet| (self.tets[tet].element, self.tets[tet].at),
        )
    }
}

/// Which of the formats a file is in.
enum Version {
    Two,
    FourOne,
}

pub(super) fn read(bytes: &[u8], limits: &MeshLimits) -> Result<TetMesh, ReadError> {
    let mut cursor = Cursor::new(bytes);
    let mut version = None;
    let mut listing = Listing::default();
    let mut entities = v4::Entities::default();
    let mut seen: Vec<&[u8]> = Vec::new();
    loop {
        cursor.skip_whitespace();
        let at = cursor.position();
        if cursor.remaining().is_empty() {
            break;
        }
        let Some(name) = cursor.line().strip_prefix(b"$") else {
            return Err(cursor.unexpected(at, "a section ($Nodes, $Elements, …)"));
        };
        let is_read =
            matches!(name, b"MeshFormat" | b"Nodes" | b"Elements" | b"Entities" | b"NOD" | b"ELM");
        if is_read && seen.contains(&name) {
            let message = format!("a second ${} section", quote(name));
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        match (name, &version) {
            (b"MeshFormat", _) => version = Some(read_format(&mut cursor)?),
            (b"NOD", None) => v2::read_nodes(&mut cursor, limits, &mut listing)?,
            (b"ELM", None) => v2::read_elements_v1(&mut cursor, limits, &mut listing)?,
            (b"Nodes" | b"Elements" | b"Entities", None) => {
                return Err(cursor.unexpected(at, "$MeshFormat first"));
            }
            (b"Nodes", Some(Version::Two)) => v2::read_nodes(&mut cursor, limits, &mut listing)?,
            (b"Elements", Some(Version::Two)) => {
                v2::read_elements(&mut cursor, limits, &mut listing)?;
            }
            (b"Entities", Some(Version::FourOne)) => entities = v4::read_entities(&mut cursor)?,
            (b"Nodes", Some(Version::FourOne)) => {
                v4::read_nodes(&mut cursor, limits, &mut listing)?;
            }
            (b"Elements", Some(Version::FourOne)) => {
                v4::read_elements(&mut cursor, limits, &mut listing)?;
            }
            (b"PartitionedEntities", _) => {
                let message = "partitioned meshes are not supported: save the mesh unpartitioned";
                return Err(cursor.error(at, ReadFault::Unsupported(message.into())));
            }
            (b"ParametricNodes", _) => {
                let message = "$ParametricNodes is not supported: save without parameters";
                return Err(cursor.error(at, ReadFault::Unsupported(message.into())));
            }
            _ => {
                if !cursor.skip_past(&[b"\n$End".as_slice(), name].concat()) {
                    let message = format!("section ${} has no end", quote(name));
                    return Err(cursor.error(at, ReadFault::Inconsistent(message)));
                }
                continue;
            }
        }
        if is_read {
            seen.push(name);
            expect_end(&mut cursor, name)?;
        }
    }
    for (section, section_v1) in [(b"Nodes".as_slice(), b"NOD"), (b"Elements", b"ELM")] {
        if !seen.contains(&section) && !seen.contains(&section_v1.as_slice()) {
            let expected = format!("a ${} section", quote(section));
            return Err(cursor.unexpected(cursor.position(), &expected));
        }
    }
    for tet in &mut listing.tets {
        tet.label = entities.label(tet.label);
    }
    listing.into_mesh(&cursor)
}

/// `version file-type data-size`, and in binary the integer 1, which tells the byte order.
fn read_format(cursor: &mut Cursor<'_>) -> Result<Version, ReadError> {
    let at = cursor.record();
    let unsupported = |cursor: &Cursor<'_>, message: String| {
        Err(cursor.error(at, ReadFault::Unsupported(message)))
    };
    let number = cursor.real("a format version")?;
    let version = match number {
        2.0..3.0 => Version::Two,
        4.1 => Version::FourOne,
        _ => {
            let message = format!("Gmsh format {number} is not supported: save as 4.1 or 2.2");
            return unsupported(cursor, message);
        }
    };
    let file_type = cursor.int("a file type")?;
    let data_size = cursor.int("a data size")?;
    if data_size != 8 {
        let message = format!("a data size of {data_size} bytes is not supported, only 8");
        return unsupported(cursor, message);
    }
    match file_type {
        0 => Ok(version),
        1 => {
            cursor.line();
            let one = cursor.remaining().first_chunk::<4>();
            let big_endian = match one {
                Some([1, 0, 0, 0]) => false,
                Some([0, 0, 0, 1]) => true,
                _ => {
                    return Err(cursor.unexpected(
                        cursor.position(),
                        "the integer 1 in 4 bytes, which tells the byte order",
                    ));
                }
            };
            cursor.encoding = Encoding::Binary { big_endian };
            cursor.skip(4);
            Ok(version)
        }
        _ => unsupported(cursor, format!("file type {file_type}: neither 0 (text) nor 1 (binary)")),
    }
}

/// `$EndNodes` after `$Nodes`, `$ENDNOD` after `$NOD`.
fn expect_end(cursor: &mut Cursor<'_>, name: &[u8]) -> Result<(), ReadError> {
    cursor.skip_whitespace();
    let at = cursor.position();
    let line = cursor.line();
    let is_end = [b"$End".as_slice(), b"$END"]
        .iter()
        .any(|prefix| line.strip_prefix(*prefix).is_some_and(|rest| rest == name));
    if !is_end {
        let expected = format!("the end of section ${}", quote(name));
        return Err(cursor.unexpected(at, &expected));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
