//! Vega .veg files of tetrahedra (text). Source: the format's description in VegaFEM's user manual.
//!
//! ```text
//! *VERTICES            *ELEMENTS        *MATERIAL name            *SET name    *REGION
//! n 3 0 0              TET              ENU, density, E, nu       1, 2, 3      set, material
//! 1 x y z              n 4 0
//! …                    1 a b c d
//! ```
//! The first vertex (element) says whether vertices (elements) are numbered from 0 or from 1.
//! A tet's domain is the place, from zero in order of appearance, of the material that its region
//! assigns; where regions overlap the later one holds. A file without regions is one domain of the
//! only material, if it has one. `#` starts a comment; numbers may be parted by commas.

use super::cursor::{Cursor, quote};
use super::line::{self, Line};
use super::reader::{MeshFile, MeshLimits, ReadError, ReadFault, validate};
use crate::material::Material;
use std::collections::{BTreeMap, HashMap, HashSet};

/// The set that every file has without saying so.
const ALL_ELEMENTS: &str = "allElements";

/// The shortest vertex or element, line end included: `1 0 0 0`.
const MIN_RECORD: u64 = 8;

#[derive(Default)]
struct Parser {
    vertices: Vec<[f64; 3]>,
    vertices_at: Vec<usize>,
    first_vertex: u64,
    tets: Vec<[u32; 4]>,
    tets_at: Vec<usize>,
    first_element: u64,
    materials: Vec<Material>,
    label_of_material: HashMap<String, i64>,
    sets: HashMap<String, Vec<(u64, usize)>>,
    regions: Vec<Region>,
}

struct Region {
    at: usize,
    set: String,
    material: String,
}

pub(super) fn read(bytes: &[u8], limits: &MeshLimits) -> Result<MeshFile, ReadError> {
    let mut cursor = Cursor::new(bytes);
    let mut parser = Parser::default();
    while let Some(line) = next_line(&mut cursor)? {
        let argument = line.fields.get(1).copied();
        match (line.fields[0].to_ascii_uppercase().as_str(), argument) {
            ("*VERTICES", _) => parser.read_vertices(&mut cursor, line.at, limits)?,
            ("*ELEMENTS", _) => parser.read_elements(&mut cursor, line.at, limits)?,
            ("*MATERIAL", Some(name)) => parser.read_material(&mut cursor, line.at, name)?,
            ("*SET", Some(name)) => parser.read_set(&mut cursor, line.at, name)?,
            ("*REGION", _) => parser.read_region(&mut cursor)?,
            ("*MATERIAL" | "*SET", None) => return Err(cursor.unexpected(line.at, "a name")),
            (keyword, _) if keyword.starts_with('*') => {
                let message = format!("{} is not supported", quote(line.fields[0].as_bytes()));
                return Err(cursor.error(line.at, ReadFault::Unsupported(message)));
            }
            _ => return Err(cursor.unexpected(line.at, "a keyword (*VERTICES, *ELEMENTS, …)")),
        }
    }
    parser.into_file(&cursor)
}

/// The next line that says something; includes are refused.
fn next_line<'a>(cursor: &mut Cursor<'a>) -> Result<Option<Line<'a>>, ReadError> {
    let line = line::next(cursor)?;
    if let Some(line) = &line
        && line.fields[0].eq_ignore_ascii_case("*INCLUDE")
    {
        let message = "*INCLUDE is not supported: put the included lines into this file";
        return Err(cursor.error(line.at, ReadFault::Unsupported(message.into())));
    }
    Ok(line)
}

/// The next line, which has to be there.
fn required_line<'a>(cursor: &mut Cursor<'a>, expected: &str) -> Result<Line<'a>, ReadError> {
    let line = next_line(cursor)?;
    line.ok_or_else(|| cursor.unexpected(cursor.position(), expected))
}

impl Parser {
    fn read_vertices(
        &mut self,
        cursor: &mut Cursor<'_>,
        at: usize,
        limits: &MeshLimits,
    ) -> Result<(), ReadError> {
        if !self.vertices.is_empty() {
            let message = "a second *VERTICES section".into();
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        let header = required_line(cursor, "the number of vertices")?;
        let n: u64 = header.number(cursor, 0, "the number of vertices")?;
        if header.number::<u64>(cursor, 1, "the dimension 3")? != 3 {
            let message = "vertices must have dimension 3".into();
            return Err(cursor.error(header.at, ReadFault::Unsupported(message)));
        }
        cursor.check_limit("vertices", n, limits.max_vertices)?;
        cursor.check_room("vertices", n, MIN_RECORD)?;
        for position in 0..n {
            let line = required_line(cursor, "a vertex")?;
            line.check_number(cursor, "the vertex number", position, &mut self.first_vertex)?;
            let mut x = [0.0; 3];
            for (axis, coordinate) in x.iter_mut().enumerate() {
                *coordinate = line.number(cursor, axis + 1, "a coordinate")?;
            }
            self.vertices.push(x);
            self.vertices_at.push(line.at);
        }
        Ok(())
    }

    fn read_elements(
        &mut self,
        cursor: &mut Cursor<'_>,
        at: usize,
        limits: &MeshLimits,
    ) -> Result<(), ReadError> {
        if !self.tets.is_empty() {
            let message = "a second *ELEMENTS section".into();
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        if self.vertices.is_empty() {
            return Err(cursor.unexpected(at, "*VERTICES first"));
        }
        let kind = required_line(cursor, "TET")?;
        if !kind.fields[0].eq_ignore_ascii_case("TET") {
            let message = format!(
                "elements of type {} are not supported, only TET",
                quote(kind.fields[0].as_bytes())
            );
            return Err(cursor.error(kind.at, ReadFault::Unsupported(message)));
        }
        let header = required_line(cursor, "the number of elements")?;
        let n: u64 = header.number(cursor, 0, "the number of elements")?;
        if header.number::<u64>(cursor, 1, "4 vertices an element")? != 4 {
            let message = "elements must have 4 vertices".into();
            return Err(cursor.error(header.at, ReadFault::Unsupported(message)));
        }
        cursor.check_limit("tets", n, limits.max_tets)?;
        cursor.check_room("tets", n, MIN_RECORD)?;
        for position in 0..n {
            let line = required_line(cursor, "an element")?;
            line.check_number(cursor, "the element number", position, &mut self.first_element)?;
            let mut corners = [0; 4];
            for (field, corner) in corners.iter_mut().enumerate() {
                let number: u64 = line.number(cursor, field + 1, "a vertex number")?;
                let vertex = number.checked_sub(self.first_vertex);
                let vertex = vertex.filter(|&vertex| vertex < self.vertices.len() as u64);
                let Some(vertex) = vertex else {
                    let message = format!(
                        "element {}: vertex {number} is not among {} to {}",
                        self.first_element + position,
                        self.first_vertex,
                        self.first_vertex + self.vertices.len() as u64 - 1
                    );
                    return Err(cursor.error(line.at, ReadFault::Inconsistent(message)));
                };
                *corner = vertex as u32;
            }
            self.tets.push(corners);
            self.tets_at.push(line.at);
        }
        Ok(())
    }

    fn read_material(
        &mut self,
        cursor: &mut Cursor<'_>,
        at: usize,
        name: &str,
    ) -> Result<(), ReadError> {
        let label = self.materials.len() as i64;
        if self.label_of_material.insert(name.to_owned(), label).is_some() {
            let message = format!("material {} is defined twice", quote(name.as_bytes()));
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        let line = required_line(cursor, "ENU, density, E, nu")?;
        if !line.fields[0].eq_ignore_ascii_case("ENU") {
            let message = format!(
                "materials of type {} are not supported, only ENU",
                quote(line.fields[0].as_bytes())
            );
            return Err(cursor.error(line.at, ReadFault::Unsupported(message)));
        }
        let density_kg_m3 = line.number(cursor, 1, "a density")?;
        let young_modulus_pa = line.number(cursor, 2, "Young's modulus")?;
        let poisson_ratio = line.number(cursor, 3, "Poisson's ratio")?;
        let material =
            Material::stvk(young_modulus_pa, poisson_ratio, density_kg_m3).map_err(|error| {
                let name = quote(name.as_bytes());
                cursor.error(line.at, ReadFault::Material { name, error })
            })?;
        self.materials.push(material);
        Ok(())
    }

    fn read_set(
        &mut self,
        cursor: &mut Cursor<'_>,
        at: usize,
        name: &str,
    ) -> Result<(), ReadError> {
        let mut elements = Vec::new();
        while let Some(line) = next_line(cursor)? {
            if line.fields[0].starts_with('*') {
                cursor.rewind(line.at);
                break;
            }
            for field in 0..line.fields.len() {
                elements.push((line.number(cursor, field, "an element number")?, line.at));
            }
        }
        if name == ALL_ELEMENTS || self.sets.insert(name.to_owned(), elements).is_some() {
            let message = format!("set {} is defined twice", quote(name.as_bytes()));
            return Err(cursor.error(at, ReadFault::Inconsistent(message)));
        }
        Ok(())
    }

    fn read_region(&mut self, cursor: &mut Cursor<'_>) -> Result<(), ReadError> {
        let line = required_line(cursor, "a set and a material")?;
        let &[set, material] = line.fields.as_slice() else {
            return Err(cursor.unexpected(line.at, "a set and a material"));
        };
        self.regions.push(Region { at: line.at, set: set.into(), material: material.into() });
        Ok(())
    }

    /// The place of each tet's material; empty if the file has no materials.
    fn labels(&self, cursor: &Cursor<'_>) -> Result<Vec<i64>, ReadError> {
        let inconsistent = |at, message| Err(cursor.error(at, ReadFault::Inconsistent(message)));
        if self.regions.is_empty() {
            if self.materials.len() > 1 {
                let message = format!("{} materials, but no *REGION", self.materials.len());
                return inconsistent(cursor.position(), message);
            }
            return Ok(Vec::new());
        }
        let mut labels = vec![None; self.tets.len()];
        let mut assigned = HashSet::new();
        for Region { at, set, material } in &self.regions {
            if !assigned.insert(set) {
                let message = format!("set {} is in two regions", quote(set.as_bytes()));
                return inconsistent(*at, message);
            }
            let Some(&label) = self.label_of_material.get(material) else {
                let message = format!("there is no material {}", quote(material.as_bytes()));
                return inconsistent(*at, message);
            };
            if set == ALL_ELEMENTS {
                labels.fill(Some(label));
                continue;
            }
            let Some(elements) = self.sets.get(set) else {
                return inconsistent(*at, format!("there is no set {}", quote(set.as_bytes())));
            };
            for &(element, at) in elements {
                let tet = element.checked_sub(self.first_element).map(|tet| tet as usize);
                let Some(slot) = tet.and_then(|tet| labels.get_mut(tet)) else {
                    let message =
                        format!("set {}: there is no element {element}", quote(set.as_bytes()));
                    return inconsistent(at, message);
                };
                *slot = Some(label);
            }
        }
        if let Some(tet) = labels.iter().position(Option::is_none) {
            let element = self.first_element + tet as u64;
            let message = format!("element {element} belongs to no *REGION");
            return inconsistent(self.tets_at[tet], message);
        }
        Ok(labels.into_iter().flatten().collect())
    }

    fn into_file(self, cursor: &Cursor<'_>) -> Result<MeshFile, ReadError> {
        let end = cursor.position();
        if self.vertices.is_empty() {
            return Err(cursor.unexpected(end, "a *VERTICES section"));
        }
        if self.tets.is_empty() {
            return Err(cursor.unexpected(end, "an *ELEMENTS section"));
        }
        let labels = self.labels(cursor)?;
        let mesh = validate(
            cursor,
            self.vertices,
            self.tets,
            labels,
            |vertex| (self.first_vertex + vertex as u64, self.vertices_at[vertex]),
            |tet| (self.first_element + tet as u64, self.tets_at[tet]),
        )?;
        let materials: BTreeMap<i64, Material> = (0..)
            .zip(&self.materials)
            .filter(|(label, _)| mesh.domains().binary_search(label).is_ok())
            .map(|(label, material)| (label, *material))
            .collect();
        Ok(MeshFile { mesh, materials })
    }
}

#[cfg(test)]
mod tests;
