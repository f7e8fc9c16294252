//! Format 4.1. Integers named `tag` of entities, dimensions and types are int32 in binary, counts
//! and tags of nodes and elements are 64-bit.
//!
//! ```text
//! $Entities  n_points n_curves n_surfaces n_volumes
//!            point:  tag x y z n_physical physical…
//!            others: tag box(6) n_physical physical… n_bounding bounding…
//! $Nodes     n_blocks n_nodes min_tag max_tag
//!            block:  dimension entity parametric n, then n tags, then n × (x y z [parameters])
//! $Elements  n_blocks n_elements min_tag max_tag
//!            block:  dimension entity type n, then n × (tag corners…)
//! ```

use super::element_type::{Role, refusal, role};
use super::{Cursor, Listing, Tet};
use crate::mesh::reader::{MeshLimits, ReadError, ReadFault};
use std::collections::BTreeMap;

/// The physical group of each volume that has one. A group's sign tells orientation and is dropped.
#[derive(Default)]
pub(super) struct Entities {
    physical_of_volume: BTreeMap<i64, i64>,
}

impl Entities {
    /// The domain of a tet of volume `entity`.
    pub(super) fn label(&self, entity: i64) -> i64 {
        self.physical_of_volume.get(&entity).copied().unwrap_or(entity)
    }
}

pub(super) fn read_entities(cursor: &mut Cursor<'_>) -> Result<Entities, ReadError> {
    let mut entities = Entities::default();
    cursor.record();
    let mut counts = [0; 4];
    for count in &mut counts {
        *count = cursor.size("a number of entities")?;
    }
    for (dimension, n) in counts.into_iter().enumerate() {
        // The shortest entity is a point: int, 3 doubles, count; in text `1 0 0 0 0`.
        cursor.check_room("entities", n, if cursor.is_binary() { 36 } else { 10 })?;
        for _ in 0..n {
            cursor.record();
            let tag = cursor.int("an entity tag")?;
            for _ in 0..if dimension == 0 { 3 } else { 6 } {
                cursor.real("a coordinate")?;
            }
            let n_physical = cursor.size("a number of physical groups")?;
            for position in 0..n_physical {
                let physical = cursor.int("a physical tag")?;
                if dimension == 3 && position == 0 && physical != 0 {
                    entities.physical_of_volume.insert(tag, physical.saturating_abs());
                }
            }
            if dimension > 0 {
                for _ in 0..cursor.size("a number of bounding entities")? {
                    cursor.int("a bounding entity")?;
                }
            }
        }
    }
    Ok(entities)
}

/// `n_blocks n min max`.
fn read_header(cursor: &mut Cursor<'_>, expected: &str) -> Result<(u64, u64), ReadError> {
    cursor.record();
    let n_blocks = cursor.size("a number of blocks")?;
    let n = cursor.size(expected)?;
    cursor.size("the lowest tag")?;
    cursor.size("the highest tag")?;
    Ok((n_blocks, n))
}

/// Subtracts a block's count from what the section's header has left.
fn take_block(
    cursor: &Cursor<'_>,
    at: usize,
    what: &str,
    n: u64,
    left: &mut u64,
) -> Result<(), ReadError> {
    let Some(rest) = left.checked_sub(n) else {
        let message = format!("a block of {n} {what} where {left} are left");
        return Err(cursor.error(at, ReadFault::Inconsistent(message)));
    };
    *left = rest;
    Ok(())
}

/// The blocks must hold as many things as the header declared.
fn check_sum(cursor: &Cursor<'_>, what: &str, n: u64, left: u64) -> Result<(), ReadError> {
    if left > 0 {
        let message = format!("{n} {what} declared, but the blocks hold only {}", n - left);
        return Err(cursor.error(cursor.position(), ReadFault::Inconsistent(message)));
    }
    Ok(())
}

pub(super) fn read_nodes(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
) -> Result<(), ReadError> {
    let (n_blocks, n) = read_header(cursor, "the number of nodes")?;
    cursor.check_limit("nodes", n, limits.max_vertices)?;
    // A tag and three coordinates; in text `1` and `0 0 0` with their line ends.
    cursor.check_room("nodes", n, if cursor.is_binary() { 32 } else { 8 })?;
    listing.nodes.reserve(n as usize);
    listing.vertices.reserve(n as usize);
    let mut left = n;
    for _ in 0..n_blocks {
        let at = cursor.record();
        let dimension = cursor.unsigned("an entity's dimension")?;
        if dimension > 3 {
            return Err(cursor.unexpected(at, "a dimension from 0 to 3"));
        }
        cursor.int("an entity tag")?;
        let n_parameters = if cursor.int("0 or 1 (parametric)")? == 0 { 0 } else { dimension };
        let n_block = cursor.size("a number of nodes")?;
        take_block(cursor, at, "nodes", n_block, &mut left)?;
        let mut tags = Vec::with_capacity(n_block as usize);
        for _ in 0..n_block {
            cursor.record();
            tags.push(cursor.size("a node tag")?);
        }
        for tag in tags {
            let at = cursor.record();
            let position = cursor.point()?;
            for _ in 0..n_parameters {
                cursor.real("a parametric coordinate")?;
            }
            listing.push_node(tag, at, position);
        }
    }
    check_sum(cursor, "nodes", n, left)
}

pub(super) fn read_elements(
    cursor: &mut Cursor<'_>,
    limits: &MeshLimits,
    listing: &mut Listing,
) -> Result<(), ReadError> {
    let (n_blocks, n) = read_header(cursor, "the number of elements")?;
    // The shortest element is a point: tag and node; in text `1 1` and the line end.
    cursor.check_room("elements", n, if cursor.is_binary() { 16 } else { 4 })?;
    let mut left = n;
    for _ in 0..n_blocks {
        let at = cursor.record();
        cursor.int("an entity's dimension")?;
        let entity = cursor.int("an entity tag")?;
        let element_type = cursor.int("an element type")?;
        let n_block = cursor.size("a number of elements")?;
        take_block(cursor, at, "elements", n_block, &mut left)?;
        if matches!(role(element_type), Role::Tet) {
            let n_tets = listing.tets.len() as u64 + n_block;
            cursor.check_limit("tets", n_tets, limits.max_tets)?;
            cursor.check_room("tets", n_block, if cursor.is_binary() { 40 } else { 10 })?;
            listing.tets.reserve(n_block as usize);
        }
        for _ in 0..n_block {
            let at = cursor.record();
            let element = cursor.size("an element tag")?;
            match role(element_type) {
                Role::Tet => {
                    let mut corners = [0; 4];
                    for corner in &mut corners {
                        *corner = cursor.size("a node tag")?;
                    }
                    listing.tets.push(Tet { element, corners, label: entity, at });
                }
                Role::Skipped { n_nodes } => {
                    for _ in 0..n_nodes {
                        cursor.size("a node tag")?;
                    }
                }
                Role::Refused { .. } | Role::Unknown => {
                    let message = refusal(element, element_type);
                    return Err(cursor.error(at, ReadFault::Unsupported(message)));
                }
            }
        }
    }
    check_sum(cursor, "elements", n, left)
}
