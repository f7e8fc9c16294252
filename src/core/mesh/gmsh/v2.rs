//! Formats 2.x (text and binary) and 1 (text only; its `$NOD` is written as `$Nodes` of format 2).
//!
//! ```text
//! $Nodes                       $Elements
//! n                            n
//! tag x y z                    number type n_tags physical elementary … corners
//! ```
//! In binary `n` stays text; nodes are (int32, 3 doubles), elements come in runs of one type:
//! three int32 (type, run length, n_tags), then for each element its number, tags and corners.

use super::element_type::{Role, refusal, role};
use super::{Cursor, Listing, Tet};
use crate::mesh::cursor::Encoding;
use crate::mesh::reader::{MeshLimits, ReadError, ReadFault};

/// The shortest node and element in text, line end included: `1 0 0 0`, `1 15 0 1`.
const MIN_TEXT_RECORD: u64 = 8;
const BINARY_NODE: u64 = 4 + 3 * 8;
/// An element of a binary run has at least its number and one node.
const MIN_BINARY_ELEMENT: u64 = 8;

/// The count on a text line of its own that opens a section, in binary too.
fn count(cursor: &mut Cursor<'_>, expected: &str) -> Result<u64, ReadError> {
    let encoding = std::mem::replace(&mut cursor.encoding, Encoding::Text);
    cursor.record();
    let count = cursor.size(expected);
    if encoding != Encoding::Text {
        cursor.line();
    }
    cursor.encoding = encoding;
    count
}

pub(super) fn read_nodes(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
) -> Result<(), ReadError> {
    let n = count(cursor, "the number of nodes")?;
    cursor.check_limit("nodes", n, limits.max_vertices)?;
    cursor.check_room(
        "nodes",
        n,
        if cursor.is_binary() { BINARY_NODE } else { MIN_TEXT_RECORD },
    )?;
    listing.nodes.reserve(n as usize);
    listing.vertices.reserve(n as usize);
    for _ in 0..n {
        let at = cursor.record();
        let tag = cursor.unsigned("a node number")?;
        let position = cursor.point()?;
        listing.push_node(tag, at, position);
    }
    Ok(())
}

pub(super) fn read_elements(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
) -> Result<(), ReadError> {
    let n = count(cursor, "the number of elements")?;
    if !cursor.is_binary() {
        cursor.check_room("elements", n, MIN_TEXT_RECORD)?;
        for _ in 0..n {
            let at = cursor.record();
            let element = cursor.unsigned("an element number")?;
            let element_type = cursor.int("an element type")?;
            let n_tags = cursor.unsigned("a number of tags")?;
            read_element(cursor, limits, listing, Element { at, element, element_type, n_tags })?;
        }
        return Ok(());
    }
    cursor.check_room("elements", n, MIN_BINARY_ELEMENT)?;
    let mut left = n;
    while left > 0 {
        let at = cursor.position();
        let element_type = cursor.int("an element type")?;
        let n_run = cursor.unsigned("a number of elements")?;
        let n_tags = cursor.unsigned("a number of tags")?;
        if n_run == 0 || n_run > left {
            let message = format!("a run of {n_run} elements where {left} are left");
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        for _ in 0..n_run {
            let at = cursor.position();
            let element = cursor.unsigned("an element number")?;
            read_element(cursor, limits, listing, Element { at, element, element_type, n_tags })?;
        }
        left -= n_run;
    }
    Ok(())
}

/// What stands before an element's tags.
struct Element {
    at: usize,
    element: u64,
    element_type: i64,
    n_tags: u64,
}

/// The tags and corners of one element.
fn read_element(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
    Element { at, element, element_type, n_tags }: Element,
) -> Result<(), ReadError> {
    let [mut physical, mut elementary] = [0; 2];
    for tag in 0..n_tags {
        let value = cursor.int("a tag")?;
        match tag {
            0 => physical = value,
            1 => elementary = value,
            _ => {}
        }
    }
    let label = if physical == 0 { elementary } else { physical };
    read_corners(cursor, limits, listing, at, element, element_type, label)
}

/// Format 1: `number type physical elementary n_nodes corners`.
pub(super) fn read_elements_v1(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
) -> Result<(), ReadError> {
    let n = count(cursor, "the number of elements")?;
    cursor.check_room("elements", n, MIN_TEXT_RECORD)?;
    for _ in 0..n {
        let at = cursor.record();
        let element = cursor.unsigned("an element number")?;
        let element_type = cursor.int("an element type")?;
        let physical = cursor.int("a physical region")?;
        let elementary = cursor.int("an elementary region")?;
        cursor.unsigned("a number of nodes")?;
        let label = if physical == 0 { elementary } else { physical };
        read_corners(cursor, limits, listing, at, element, element_type, label)?;
    }
    Ok(())
}

fn read_corners(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
    at: usize,
    element: u64,
    element_type: i64,
    label: i64,
) -> Result<(), ReadError> {
    match role(element_type) {
        Role::Tet => {
            cursor.check_limit("tets", listing.tets.len() as u64 + 1, limits.max_tets)?;
            let mut corners = [0; 4];
            for corner in &mut corners {
                *corner = cursor.unsigned("a node number")?;
            }
            listing.tets.push(Tet { element, corners, label, at });
        }
        Role::Skipped { n_nodes } => {
            for _ in 0..n_nodes {
                cursor.unsigned("a node number")?;
            }
        }
        Role::Refused { .. } | Role::Unknown => {
            let message = refusal(element, element_type);
            return Err(cursor.error(at, ReadFault::Unsupported(message)));
        }
    }
    Ok(())
}
