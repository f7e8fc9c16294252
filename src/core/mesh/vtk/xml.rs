//! .vtu files: VTK's XML.
//!
//! ```text
//! <VTKFile type="UnstructuredGrid" byte_order="LittleEndian" header_type="UInt64" compressor="…">
//!   <UnstructuredGrid>
//!     <Piece NumberOfPoints="8" NumberOfCells="6">
//!       <Points><DataArray type="Float64" NumberOfComponents="3" format="ascii|binary|appended" …>
//!       <Cells> connectivity, offsets, types
//!       <CellData> …
//!   <AppendedData encoding="raw|base64">_…
//! ```

use super::data::{Form, Source};
use super::{Grid, Located, Numbers, Scalar, integers, label_rank, max_cells, max_corners, points};
use crate::mesh::TetMesh;
use crate::mesh::cursor::{Cursor, quote};
use crate::mesh::reader::{MeshLimits, ReadError, ReadFault};
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;
use std::borrow::Cow;

/// An array as its element announces it.
struct Array<'a> {
    /// Where the element begins.
    at: usize,
    scalar: Scalar,
    n_components: usize,
    place: Place<'a>,
}

/// Where the numbers of an array stand.
enum Place<'a> {
    /// In text between the element's tags.
    Text(&'a [u8]),
    /// In base64 between the element's tags.
    Inline(&'a [u8]),
    /// So far behind the mark of the appended data.
    Appended(usize),
}

#[derive(Default)]
struct Parser<'a> {
    form: Option<Form>,
    /// The element that arrays belong to now.
    section: Section,
    n_pieces: usize,
    n_points: u64,
    n_cells: u64,
    points: Option<Array<'a>>,
    connectivity: Option<Array<'a>>,
    offsets: Option<Array<'a>>,
    types: Option<Array<'a>>,
    /// With the rank of its name.
    labels: Option<(usize, Array<'a>)>,
    appended: Option<Appended<'a>>,
}

#[derive(Clone, Copy, Default, PartialEq)]
enum Section {
    #[default]
    Other,
    Points,
    Cells,
    CellData,
}

struct Appended<'a> {
    bytes: &'a [u8],
    is_base64: bool,
}

pub(in crate::mesh) fn read(bytes: &[u8], limits: &MeshLimits) -> Result<TetMesh, ReadError> {
    let cursor = Cursor::new(bytes);
    let mut parser = Parser::default();
    parser.parse(bytes, &cursor, limits)?;
    parser.into_grid(&cursor, limits)?.into_mesh(&cursor, limits)
}

/// The value of an attribute.
fn attribute(element: &BytesStart<'_>, name: &str) -> Option<String> {
    let value = element.try_get_attribute(name).ok()??.value;
    Some(value.trim().to_owned())
}

impl<'a> Parser<'a> {
    fn parse(
        &mut self,
        bytes: &'a [u8],
        cursor: &Cursor<'_>,
        limits: &MeshLimits,
    ) -> Result<(), ReadError> {
        let mut reader = Reader::from_reader(bytes);
        // The element whose text is being read.
        let mut open: Option<(String, Array<'a>)> = None;
        loop {
            let at = reader.buffer_position() as usize;
            let event = reader.read_event().map_err(|error| {
                let at = (reader.error_position() as usize).min(bytes.len());
                let text: String = error.to_string().chars().take(100).collect();
                cursor.error(at, ReadFault::Inconsistent(format!("not well-formed XML: {text}")))
            })?;
            match event {
                Event::Eof => {
                    return Err(cursor.unexpected(bytes.len(), "the end of the element VTKFile"));
                }
                Event::Start(element) if element.name().as_ref() == "AppendedData" => {
                    let behind = &bytes[(reader.buffer_position() as usize).min(bytes.len())..];
                    self.appended = Some(appended(cursor, at, &element, behind)?);
                    // What follows need not be XML.
                    break;
                }
                Event::Start(element) => {
                    let found = self.open(cursor, limits, at, &element)?;
                    if let Some((name, mut array)) = found {
                        if !matches!(array.place, Place::Appended(_)) {
                            let start = reader.buffer_position() as usize;
                            set_start(&mut array.place, &bytes[start.min(bytes.len())..]);
                        }
                        open = Some((name, array));
                    }
                }
                Event::Empty(element) => {
                    let found = self.open(cursor, limits, at, &element)?;
                    if let Some((name, array)) = found {
                        self.keep(&name, array);
                    }
                    self.close(element.name().as_ref());
                }
                Event::End(element) if element.name().as_ref() == "VTKFile" => break,
                Event::End(element) => {
                    if let Some((name, mut array)) =
                        open.take_if(|_| element.name().as_ref() == "DataArray")
                    {
                        set_end(&mut array.place, bytes, at);
                        self.keep(&name, array);
                    }
                    self.close(element.name().as_ref());
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Takes note of an element; an array that may be needed is returned with its name.
    fn open(
        &mut self,
        cursor: &Cursor<'_>,
        limits: &MeshLimits,
        at: usize,
        element: &BytesStart<'_>,
    ) -> Result<Option<(String, Array<'a>)>, ReadError> {
        let unsupported = |message: String| Err(cursor.error(at, ReadFault::Unsupported(message)));
        match element.name().as_ref() {
            "VTKFile" => self.form = Some(form(cursor, at, element)?),
            "Piece" => {
                self.n_pieces += 1;
                if self.n_pieces > 1 {
                    return unsupported(
                        "files of several pieces are not supported: merge them".into(),
                    );
                }
                let count = |name: &'static str, what: &'static str, limit: usize| {
                    let text = attribute(element, name).unwrap_or_default();
                    let n: u64 = text.parse().map_err(|_| {
                        let found = format!("“{}”", quote(text.as_bytes()));
                        let expected = format!("a number as {name}");
                        cursor.error(at, ReadFault::Unexpected { expected, found })
                    })?;
                    if n > limit as u64 {
                        let fault = ReadFault::OverLimit { what, declared: n, limit: limit as u64 };
                        return Err(cursor.error(at, fault));
                    }
                    Ok(n)
                };
                self.n_points = count("NumberOfPoints", "points", limits.max_vertices)?;
                self.n_cells = count("NumberOfCells", "cells", max_cells(limits))?;
            }
            "Points" => self.section = Section::Points,
            "Cells" => self.section = Section::Cells,
            "CellData" => self.section = Section::CellData,
            "DataArray" if self.section != Section::Other => {
                let name = attribute(element, "Name").unwrap_or_default();
                let is_needed = match self.section {
                    Section::CellData => label_rank(&name).is_some(),
                    _ => true,
                };
                if is_needed {
                    return Ok(Some((name, array(cursor, at, element)?)));
                }
            }
            _ => {}
        }
        Ok(None)
    }

    fn close(&mut self, name: &str) {
        if matches!(name, "Points" | "Cells" | "CellData") {
            self.section = Section::Other;
        }
    }

    fn keep(&mut self, name: &str, array: Array<'a>) {
        match (self.section, name) {
            (Section::Points, _) => self.points = Some(array),
            (Section::Cells, "connectivity") => self.connectivity = Some(array),
            (Section::Cells, "offsets") => self.offsets = Some(array),
            (Section::Cells, "types") => self.types = Some(array),
            (Section::CellData, _) if array.n_components == 1 => {
                if let Some(rank) = label_rank(name)
                    && self.labels.as_ref().is_none_or(|(best, _)| rank < *best)
                {
                    self.labels = Some((rank, array));
                }
            }
            _ => {}
        }
    }

    fn into_grid(mut self, cursor: &Cursor<'_>, limits: &MeshLimits) -> Result<Grid, ReadError> {
        let missing = |what: &str| cursor.unexpected(cursor.remaining().len(), what);
        let form = self.form.ok_or_else(|| missing("an element VTKFile"))?;
        if self.n_pieces == 0 {
            return Err(missing("an element Piece"));
        }
        let n_cells = self.n_cells as usize;
        let [offsets, types, corners, points_array] =
            [&mut self.offsets, &mut self.types, &mut self.connectivity, &mut self.points]
                .map(Option::take);
        let decode = |array: Option<Array<'a>>, what: &str, n: usize| {
            let array = array.ok_or_else(|| missing(what))?;
            let numbers = decode(cursor, &array, form, self.appended.as_ref(), n)?;
            if numbers.len() != n {
                let message = format!("{what} holds {} numbers, not {n}", numbers.len());
                return Err(cursor.error(array.at, ReadFault::Inconsistent(message)));
            }
            Ok((array.at, numbers))
        };
        let (at, numbers) = decode(offsets, "offsets", n_cells)?;
        let offsets = integers(cursor, at, numbers)?;
        let n_corners = offsets.values.last().copied().unwrap_or(0);
        let most = max_corners(limits);
        let Some(n_corners) = usize::try_from(n_corners).ok().filter(|n| *n <= most) else {
            let message = format!("the last offset is {n_corners}, not 0 to {most}");
            return Err(cursor.error(offsets.at, ReadFault::Inconsistent(message)));
        };
        let (at, numbers) = decode(types, "types", n_cells)?;
        let types = integers(cursor, at, numbers)?;
        let (at, numbers) = decode(corners, "connectivity", n_corners)?;
        let corners = integers(cursor, at, numbers)?;
        let (at, numbers) = decode(points_array, "points", 3 * self.n_points as usize)?;
        let points = points(cursor, at, &numbers)?;
        let labels = match self.labels.take() {
            Some((_, array)) => {
                let (at, values) = decode(Some(array), "labels", n_cells)?;
                Some(Located { at, values })
            }
            None => None,
        };
        Ok(Grid { points, offsets, corners, types, labels })
    }
}

fn set_start<'a>(place: &mut Place<'a>, behind: &'a [u8]) {
    match place {
        Place::Text(bytes) | Place::Inline(bytes) => *bytes = behind,
        Place::Appended(_) => {}
    }
}

/// Cuts the text of an element at its end tag, which stands `at` bytes into the file.
fn set_end(place: &mut Place<'_>, file: &[u8], at: usize) {
    match place {
        Place::Text(bytes) | Place::Inline(bytes) => {
            let n_behind = file.len() - at;
            let text = &bytes[..bytes.len().saturating_sub(n_behind)];
            // VTK puts elements of information before the numbers or behind them.
            let before = text.split(|&byte| byte == b'<').next().unwrap_or(text);
            let behind = text.rsplit(|&byte| byte == b'>').next().unwrap_or(text);
            *bytes = if before.trim_ascii().is_empty() { behind } else { before };
        }
        Place::Appended(_) => {}
    }
}

fn form(cursor: &Cursor<'_>, at: usize, element: &BytesStart<'_>) -> Result<Form, ReadError> {
    let unsupported = |message: String| cursor.error(at, ReadFault::Unsupported(message));
    let kind = attribute(element, "type").unwrap_or_default();
    if kind != "UnstructuredGrid" {
        let kind = quote(kind.as_bytes());
        return Err(unsupported(format!("a VTKFile of type “{kind}”: only UnstructuredGrid")));
    }
    let is_compressed = match attribute(element, "compressor").as_deref() {
        None | Some("") => false,
        Some("vtkZLibDataCompressor") => true,
        Some(other) => {
            let other = quote(other.as_bytes());
            let message =
                format!("the compressor {other} is not supported: save with zlib or none");
            return Err(unsupported(message));
        }
    };
    let header = match attribute(element, "header_type").as_deref() {
        None | Some("UInt32") => Scalar::U32,
        Some("UInt64") => Scalar::U64,
        Some(other) => {
            return Err(unsupported(format!("the header type {}", quote(other.as_bytes()))));
        }
    };
    let is_big_endian = attribute(element, "byte_order").as_deref() == Some("BigEndian");
    Ok(Form { is_big_endian, header, is_compressed })
}

fn array<'a>(
    cursor: &Cursor<'_>,
    at: usize,
    element: &BytesStart<'_>,
) -> Result<Array<'a>, ReadError> {
    let unexpected = |expected: &str, found: Option<String>| {
        let found = match found {
            Some(text) => format!("“{}”", quote(text.as_bytes())),
            None => "nothing".to_owned(),
        };
        cursor.error(at, ReadFault::Unexpected { expected: expected.to_owned(), found })
    };
    let kind = attribute(element, "type");
    let scalar = kind.as_deref().and_then(Scalar::of_xml);
    let scalar = scalar.ok_or_else(|| unexpected("a type such as Float64", kind))?;
    let n_components = match attribute(element, "NumberOfComponents") {
        None => 1,
        Some(text) => match text.parse() {
            Ok(n) => n,
            Err(_) => return Err(unexpected("a number of components", Some(text))),
        },
    };
    let place = match attribute(element, "format").as_deref() {
        None | Some("ascii") => Place::Text(&[]),
        Some("binary") => Place::Inline(&[]),
        Some("appended") => {
            let offset = attribute(element, "offset");
            let number = offset.as_deref().and_then(|text| text.parse().ok());
            Place::Appended(number.ok_or_else(|| unexpected("an offset", offset))?)
        }
        Some(other) => {
            return Err(unexpected("the format ascii, binary or appended", Some(other.into())));
        }
    };
    Ok(Array { at, scalar, n_components, place })
}

/// The appended data: from behind the mark `_` on; base64 ends at the next tag.
fn appended<'a>(
    cursor: &Cursor<'_>,
    at: usize,
    element: &BytesStart<'_>,
    behind: &'a [u8],
) -> Result<Appended<'a>, ReadError> {
    let is_base64 = match attribute(element, "encoding").as_deref() {
        Some("raw") => false,
        None | Some("base64") => true,
        Some(other) => {
            let message = format!("appended data in {} is not supported", quote(other.as_bytes()));
            return Err(cursor.error(at, ReadFault::Unsupported(message)));
        }
    };
    let Some(bytes) = behind.trim_ascii_start().strip_prefix(b"_") else {
        let fault = ReadFault::Inconsistent("the appended data do not begin with _".into());
        return Err(cursor.error(at, fault));
    };
    let end = if is_base64 { bytes.iter().position(|&byte| byte == b'<') } else { None };
    Ok(Appended { bytes: &bytes[..end.unwrap_or(bytes.len())], is_base64 })
}

/// The numbers of an array, of which there should be `n`.
fn decode(
    cursor: &Cursor<'_>,
    array: &Array<'_>,
    form: Form,
    appended: Option<&Appended<'_>>,
    n: usize,
) -> Result<Numbers, ReadError> {
    let fault = |message: String| cursor.error(array.at, ReadFault::Inconsistent(message));
    let limit = n.saturating_mul(array.scalar.size());
    let characters;
    let mut source = match array.place {
        Place::Text(text) => return numbers(text, array.scalar, n).map_err(fault),
        Place::Inline(text) => {
            characters = without_blanks(text);
            Source::base64(&characters)
        }
        Place::Appended(offset) => {
            let appended = appended.ok_or_else(|| fault("there are no appended data".into()))?;
            let Some(bytes) = appended.bytes.get(offset..) else {
                let message = format!(
                    "offset {offset} is beyond the {} bytes appended",
                    appended.bytes.len()
                );
                return Err(fault(message));
            };
            match appended.is_base64 {
                true => {
                    characters = without_blanks(bytes);
                    Source::base64(&characters)
                }
                false => Source::Raw(bytes),
            }
        }
    };
    let bytes = source.array(form, limit).map_err(fault)?;
    Ok(array.scalar.decode(&bytes, form.is_big_endian))
}

/// Base64 without the line ends and indents that a writer may have put in.
fn without_blanks(text: &[u8]) -> Cow<'_, [u8]> {
    let text = text.trim_ascii();
    if text.iter().any(u8::is_ascii_whitespace) {
        text.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect()
    } else {
        Cow::Borrowed(text)
    }
}

/// Numbers in text; at most one more than the `n` that there should be.
fn numbers(text: &[u8], scalar: Scalar, n: usize) -> Result<Numbers, String> {
    let text = std::str::from_utf8(text).map_err(|error| format!("not text: {error}"))?;
    let words = text.split_ascii_whitespace().take(n.saturating_add(1));
    fn all<'t, T: std::str::FromStr>(
        words: impl Iterator<Item = &'t str>,
    ) -> Result<Vec<T>, String> {
        let wrong =
            |word: &str| format!("“{}” is not a number of its type", quote(word.as_bytes()));
        words.map(|word| word.parse().map_err(|_| wrong(word))).collect()
    }
    Ok(if scalar.is_integer() {
        Numbers::Integers(all(words)?)
    } else {
        Numbers::Reals(all(words)?)
    })
}
