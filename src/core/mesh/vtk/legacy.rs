//! Legacy .vtk files.
//!
//! ```text
//! # vtk DataFile Version 3.0        CELLS n n_numbers      (up to version 4: count, corners of each cell)
//! title                             CELLS n + 1 n_corners  (from 5 on, in two arrays)
//! ASCII or BINARY                   OFFSETS type … CONNECTIVITY type …
//! DATASET UNSTRUCTURED_GRID         CELL_TYPES n
//! POINTS n type                     CELL_DATA n, then SCALARS, FIELD, …
//! ```
//! Binary numbers are big-endian and begin after the line that announces them.

use super::{Grid, Located, Numbers, Scalar, integers, label_rank, max_cells, max_corners, points};
use crate::mesh::TetMesh;
use crate::mesh::cursor::{Cursor, Encoding, quote};
use crate::mesh::reader::{MeshLimits, ReadError, ReadFault};

/// Most components of one tuple of an attribute.
const MAX_COMPONENTS: u64 = 64;
/// Most arrays of a FIELD.
const MAX_FIELD_ARRAYS: u64 = 4096;

/// What attributes belong to.
#[derive(Clone, Copy, PartialEq)]
enum Owner {
    Nothing,
    Cells,
    Points,
}

struct Parser<'a, 'l> {
    cursor: Cursor<'a>,
    limits: &'l MeshLimits,
    is_binary: bool,
    points: Option<Located<Vec<[f64; 3]>>>,
    offsets: Option<Located<Vec<i64>>>,
    corners: Option<Located<Vec<i64>>>,
    types: Option<Located<Vec<i64>>>,
    /// With the rank of its name.
    labels: Option<(usize, Located<Numbers>)>,
}

/// A line of keywords and counts.
struct Line<'a> {
    at: usize,
    fields: Vec<&'a str>,
}

impl Line<'_> {
    fn keyword(&self) -> String {
        self.fields.first().map(|field| field.to_ascii_uppercase()).unwrap_or_default()
    }
}

pub(in crate::mesh) fn read(bytes: &[u8], limits: &MeshLimits) -> Result<TetMesh, ReadError> {
    let mut cursor = Cursor::new(bytes);
    cursor.skip_whitespace();
    let at = cursor.position();
    if !cursor.line().to_ascii_lowercase().starts_with(b"# vtk datafile version") {
        return Err(cursor.unexpected(at, "# vtk DataFile Version"));
    }
    cursor.line();
    let at = cursor.record();
    let is_binary = match cursor.line().to_ascii_uppercase().as_slice() {
        b"ASCII" => false,
        b"BINARY" => true,
        _ => return Err(cursor.unexpected(at, "ASCII or BINARY")),
    };
    let mut parser = Parser {
        cursor,
        limits,
        is_binary,
        points: None,
        offsets: None,
        corners: None,
        types: None,
        labels: None,
    };
    parser.read()?;
    let Parser { cursor, points, offsets, corners, types, labels, .. } = parser;
    let missing = |what: &str| cursor.unexpected(cursor.position(), what);
    let grid = Grid {
        points: points.ok_or_else(|| missing("POINTS"))?,
        offsets: offsets.ok_or_else(|| missing("CELLS"))?,
        corners: corners.ok_or_else(|| missing("CELLS"))?,
        types: types.ok_or_else(|| missing("CELL_TYPES"))?,
        labels: labels.map(|(_, labels)| labels),
    };
    grid.into_mesh(&cursor, limits)
}

impl<'a> Parser<'a, '_> {
    fn read(&mut self) -> Result<(), ReadError> {
        let (mut owner, mut n_tuples) = (Owner::Nothing, 0);
        while let Some(line) = self.line()? {
            match line.keyword().as_str() {
                "DATASET" => {
                    let kind = line.fields.get(1).copied().unwrap_or_default();
                    if !kind.eq_ignore_ascii_case("UNSTRUCTURED_GRID") {
                        let message = format!(
                            "a dataset of type {} is not supported, only UNSTRUCTURED_GRID",
                            quote(kind.as_bytes())
                        );
                        return Err(self.unsupported(line.at, message));
                    }
                }
                "POINTS" => self.read_points(&line)?,
                "CELLS" => self.read_cells(&line)?,
                "CELL_TYPES" => {
                    let n = self.count(&line, 1, "cells", max_cells(self.limits))?;
                    let numbers = self.numbers(line.at, Scalar::I32, n)?;
                    self.types = Some(integers(&self.cursor, line.at, numbers)?);
                }
                "CELL_DATA" => {
                    owner = Owner::Cells;
                    n_tuples = self.count(&line, 1, "cells", max_cells(self.limits))?;
                }
                "POINT_DATA" => {
                    owner = Owner::Points;
                    n_tuples = self.count(&line, 1, "points", self.limits.max_vertices)?;
                }
                "METADATA" => self.skip_metadata(),
                "FIELD" => self.read_field(&line, owner)?,
                // How many of these numbers there are is said by CELL_DATA or POINT_DATA.
                keyword if owner != Owner::Nothing => {
                    let is_read = self.read_attribute(keyword, &line, owner, n_tuples)?;
                    if !is_read {
                        return Err(self.unexpected(&line, "an attribute (SCALARS, FIELD, …)"));
                    }
                }
                _ => return Err(self.unexpected(&line, "a section (POINTS, CELLS, …)")),
            }
        }
        Ok(())
    }

    /// The next line that is not blank.
    fn line(&mut self) -> Result<Option<Line<'a>>, ReadError> {
        self.cursor.skip_whitespace();
        let at = self.cursor.position();
        if self.cursor.remaining().is_empty() {
            return Ok(None);
        }
        let bytes = self.cursor.line();
        let Ok(text) = std::str::from_utf8(bytes) else {
            return Err(self.cursor.unexpected(at, "a line of text"));
        };
        Ok(Some(Line { at, fields: text.split_ascii_whitespace().collect() }))
    }

    fn required_line(&mut self, expected: &str) -> Result<Line<'a>, ReadError> {
        let line = self.line()?;
        line.ok_or_else(|| self.cursor.unexpected(self.cursor.position(), expected))
    }

    fn unexpected(&self, line: &Line<'_>, expected: &str) -> ReadError {
        self.cursor.unexpected(line.at, expected)
    }

    fn unsupported(&self, at: usize, message: String) -> ReadError {
        self.cursor.error(at, ReadFault::Unsupported(message))
    }

    /// The number in a field of a line, held against a limit.
    fn count(
        &self,
        line: &Line<'_>,
        field: usize,
        what: &'static str,
        limit: usize,
    ) -> Result<u64, ReadError> {
        let number = line.fields.get(field).and_then(|text| text.parse().ok());
        let number = number.ok_or_else(|| {
            let found = match line.fields.get(field) {
                Some(text) => format!("“{}”", quote(text.as_bytes())),
                None => "the end of the line".to_owned(),
            };
            let expected = format!("a number of {what}");
            self.cursor.error(line.at, ReadFault::Unexpected { expected, found })
        })?;
        if number > limit as u64 {
            let fault = ReadFault::OverLimit { what, declared: number, limit: limit as u64 };
            return Err(self.cursor.error(line.at, fault));
        }
        Ok(number)
    }

    fn scalar(&self, line: &Line<'_>, field: usize) -> Result<Scalar, ReadError> {
        let name = line.fields.get(field).copied().unwrap_or_default();
        Scalar::of_legacy(name).ok_or_else(|| {
            let message = format!("numbers of type “{}” are not supported", quote(name.as_bytes()));
            self.unsupported(line.at, message)
        })
    }

    /// The `n` numbers that follow, `at` being the line that announces them.
    fn numbers(&mut self, at: usize, scalar: Scalar, n: u64) -> Result<Numbers, ReadError> {
        if !self.is_binary {
            // The shortest number and a blank.
            self.cursor.check_room("numbers", n, 2)?;
            let cursor = &mut self.cursor;
            return Ok(if scalar.is_integer() {
                Numbers::Integers(all(n, || cursor.free_int("an integer"))?)
            } else {
                Numbers::Reals(all(n, || cursor.free_real("a number"))?)
            });
        }
        self.cursor.encoding = Encoding::Binary { big_endian: true };
        let result = self.cursor.check_room("numbers", n, scalar.size() as u64).map(|()| {
            let size = (n as usize * scalar.size()).min(self.cursor.remaining().len());
            let numbers = scalar.decode(&self.cursor.remaining()[..size], true);
            self.cursor.skip(size);
            numbers
        });
        self.cursor.encoding = Encoding::Text;
        let numbers = result?;
        if numbers.len() as u64 != n {
            let fault = ReadFault::Truncated { what: "numbers", declared: n, remaining: 0 };
            return Err(self.cursor.error(at, fault));
        }
        Ok(numbers)
    }

    fn read_points(&mut self, line: &Line<'_>) -> Result<(), ReadError> {
        let n = self.count(line, 1, "points", self.limits.max_vertices)?;
        let scalar = self.scalar(line, 2)?;
        let numbers = self.numbers(line.at, scalar, 3 * n)?;
        self.points = Some(points(&self.cursor, line.at, &numbers)?);
        Ok(())
    }

    fn read_cells(&mut self, line: &Line<'_>) -> Result<(), ReadError> {
        let limit = max_corners(self.limits).saturating_add(max_cells(self.limits));
        let n = self.count(line, 1, "cells", max_cells(self.limits).saturating_add(1))?;
        let n_numbers = self.count(line, 2, "corners", limit)?;
        let at = self.cursor.position();
        let next = self.line()?;
        if let Some(offsets_line) = next
            && offsets_line.keyword() == "OFFSETS"
        {
            let scalar = self.scalar(&offsets_line, 1)?;
            let numbers = self.numbers(offsets_line.at, scalar, n)?;
            let mut offsets = integers(&self.cursor, offsets_line.at, numbers)?;
            // The first one is where the first cell begins.
            if !offsets.values.is_empty() {
                offsets.values.remove(0);
            }
            self.offsets = Some(offsets);
            let line = self.required_line("CONNECTIVITY")?;
            if line.keyword() != "CONNECTIVITY" {
                return Err(self.unexpected(&line, "CONNECTIVITY"));
            }
            let scalar = self.scalar(&line, 1)?;
            let numbers = self.numbers(line.at, scalar, n_numbers)?;
            self.corners = Some(integers(&self.cursor, line.at, numbers)?);
            return Ok(());
        }
        self.cursor.rewind(at);
        let numbers = self.numbers(line.at, Scalar::I32, n_numbers)?;
        let listed = integers(&self.cursor, line.at, numbers)?.values;
        let (mut offsets, mut corners) = (Vec::new(), Vec::new());
        let mut rest = listed.as_slice();
        for cell in 0..n {
            let found = rest
                .split_first()
                .and_then(|(&count, behind)| behind.split_at_checked(usize::try_from(count).ok()?));
            let Some((of_cell, left)) = found else {
                let message = format!("cell {cell}: its corners are not among the numbers given");
                return Err(self.cursor.error(line.at, ReadFault::Inconsistent(message)));
            };
            corners.extend_from_slice(of_cell);
            offsets.push(corners.len() as i64);
            rest = left;
        }
        if !rest.is_empty() {
            let message = format!("{} numbers follow the last cell", rest.len());
            return Err(self.cursor.error(line.at, ReadFault::Inconsistent(message)));
        }
        self.offsets = Some(Located { at: line.at, values: offsets });
        self.corners = Some(Located { at: line.at, values: corners });
        Ok(())
    }

    /// Keeps `numbers` if they are the best labels so far.
    fn consider(&mut self, name: &str, owner: Owner, n_components: u64, found: Located<Numbers>) {
        let rank = label_rank(name).filter(|_| owner == Owner::Cells && n_components == 1);
        if let Some(rank) = rank
            && self.labels.as_ref().is_none_or(|(best, _)| rank < *best)
        {
            self.labels = Some((rank, found));
        }
    }

    fn read_field(&mut self, line: &Line<'_>, owner: Owner) -> Result<(), ReadError> {
        let n_arrays = self.count(line, 2, "arrays", MAX_FIELD_ARRAYS as usize)?;
        for _ in 0..n_arrays {
            let mut line = self.required_line("an array of the FIELD")?;
            if line.keyword() == "METADATA" {
                self.skip_metadata();
                line = self.required_line("an array of the FIELD")?;
            }
            let n_components = self.count(&line, 1, "components", MAX_COMPONENTS as usize)?;
            let n_tuples = self.count(&line, 2, "tuples", max_corners(self.limits))?;
            let name = line.fields[0];
            if line.fields.get(3).is_some_and(|kind| kind.eq_ignore_ascii_case("string")) {
                return Err(self.unsupported(line.at, "arrays of strings are not supported".into()));
            }
            let scalar = self.scalar(&line, 3)?;
            let values = self.numbers(line.at, scalar, n_components * n_tuples)?;
            self.consider(name, owner, n_components, Located { at: line.at, values });
        }
        Ok(())
    }

    /// Whether `keyword` is an attribute: then it is read.
    fn read_attribute(
        &mut self,
        keyword: &str,
        line: &Line<'_>,
        owner: Owner,
        n_tuples: u64,
    ) -> Result<bool, ReadError> {
        let name = line.fields.get(1).copied().unwrap_or_default();
        let (n_components, type_field) = match keyword {
            "SCALARS" => {
                let given = line.fields.get(3).map(|_| self.count(line, 3, "components", 4));
                (given.transpose()?.unwrap_or(1), Some(2))
            }
            "VECTORS" | "NORMALS" => (3, Some(2)),
            "TENSORS" => (9, Some(2)),
            "TENSORS6" => (6, Some(2)),
            "GLOBAL_IDS" | "PEDIGREE_IDS" => (1, Some(2)),
            "TEXTURE_COORDINATES" => (self.count(line, 2, "components", 3)?, Some(3)),
            "COLOR_SCALARS" => (self.count(line, 2, "components", 4)?, None),
            // The colours of a table of its own: four numbers each.
            "LOOKUP_TABLE" => {
                let n = self.count(line, 2, "colours", max_cells(self.limits))?;
                self.colours(line.at, 4 * n)?;
                return Ok(true);
            }
            _ => return Ok(false),
        };
        let Some(type_field) = type_field else {
            self.colours(line.at, n_components * n_tuples)?;
            return Ok(true);
        };
        let scalar = self.scalar(line, type_field)?;
        if keyword == "SCALARS" {
            let at = self.cursor.position();
            let table = self.required_line("LOOKUP_TABLE")?;
            if table.keyword() != "LOOKUP_TABLE" {
                // The table may be left out.
                self.cursor.rewind(at);
            }
        }
        let values = self.numbers(line.at, scalar, n_components * n_tuples)?;
        self.consider(name, owner, n_components, Located { at: line.at, values });
        Ok(true)
    }

    /// Colours: bytes in a binary file, numbers from 0 to 1 in text.
    fn colours(&mut self, at: usize, n: u64) -> Result<(), ReadError> {
        let scalar = if self.is_binary { Scalar::U8 } else { Scalar::F32 };
        self.numbers(at, scalar, n).map(|_| ())
    }

    /// Skips to the blank line that ends a METADATA block.
    fn skip_metadata(&mut self) {
        while !self.cursor.remaining().is_empty() && !self.cursor.line().is_empty() {}
    }
}

fn all<T>(n: u64, mut next: impl FnMut() -> Result<T, ReadError>) -> Result<Vec<T>, ReadError> {
    (0..n).map(|_| next()).collect()
}
