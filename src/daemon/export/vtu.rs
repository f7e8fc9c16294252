//! VTK's .vtu (appended raw data) and .pvd files.

use std::io::{self, Write};

/// A grid of tets with vectors at its points.
pub(super) struct Grid<'a> {
    pub(super) points: &'a [[f64; 3]],
    pub(super) tets: &'a [[u32; 4]],
    /// One for each tet, as the cell data `domain`.
    pub(super) labels: Option<&'a [i64]>,
    /// By name; `n_points × 3` each.
    pub(super) vectors: &'a [(String, &'a [f64])],
}

const TETRA: u8 = 10;

/// An array behind the mark of the appended data.
struct Block<'a> {
    /// The attributes of its element.
    attributes: String,
    data: Data<'a>,
}

enum Data<'a> {
    Reals(&'a [f64]),
    Labels(&'a [i64]),
    /// The corners of tets.
    Corners(&'a [[u32; 4]]),
    /// Where the corners of each of so many tets end.
    Ends(usize),
    /// The types of so many tets.
    Types(usize),
}

impl Data<'_> {
    fn n_bytes(&self) -> usize {
        match self {
            Data::Reals(values) => 8 * values.len(),
            Data::Labels(values) => 8 * values.len(),
            Data::Corners(tets) => 32 * tets.len(),
            Data::Ends(n) => 8 * n,
            Data::Types(n) => *n,
        }
    }

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        match self {
            Data::Reals(values) => values.iter().try_for_each(|x| file.write_all(&x.to_le_bytes())),
            Data::Labels(values) => {
                values.iter().try_for_each(|label| file.write_all(&label.to_le_bytes()))
            }
            Data::Corners(tets) => {
                let mut corners = tets.as_flattened().iter();
                corners.try_for_each(|&corner| file.write_all(&i64::from(corner).to_le_bytes()))
            }
            Data::Ends(n) => {
                (1..=*n as i64).try_for_each(|i| file.write_all(&(4 * i).to_le_bytes()))
            }
            Data::Types(n) => file.write_all(&vec![TETRA; *n]),
        }
    }
}

/// Vectors of three.
fn vectors<'a>(name: &str, values: &'a [f64]) -> Block<'a> {
    let attributes = format!("type=\"Float64\" Name=\"{}\" NumberOfComponents=\"3\"", text(name));
    Block { attributes, data: Data::Reals(values) }
}

fn integers<'a>(kind: &str, name: &str, data: Data<'a>) -> Block<'a> {
    Block { attributes: format!("type=\"{kind}\" Name=\"{name}\""), data }
}

impl Grid<'_> {
    pub(super) fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let (n_points, n_tets) = (self.points.len(), self.tets.len());
        let point_data = self.vectors.iter().map(|(name, values)| vectors(name, values)).collect();
        let labels = self.labels.iter();
        let cell_data = labels.map(|l| integers("Int64", "domain", Data::Labels(l))).collect();
        let sections: [(&str, Vec<Block<'_>>); 4] = [
            ("PointData", point_data),
            ("CellData", cell_data),
            ("Points", vec![vectors("Points", self.points.as_flattened())]),
            (
                "Cells",
                vec![
                    integers("Int64", "connectivity", Data::Corners(self.tets)),
                    integers("Int64", "offsets", Data::Ends(n_tets)),
                    integers("UInt8", "types", Data::Types(n_tets)),
                ],
            ),
        ];
        writeln!(
            file,
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" \
             byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<UnstructuredGrid>\n\
             <Piece NumberOfPoints=\"{n_points}\" NumberOfCells=\"{n_tets}\">"
        )?;
        let mut offset = 0;
        for (section, blocks) in &sections {
            writeln!(file, "<{section}>")?;
            for Block { attributes, data } in blocks {
                let place = format!("format=\"appended\" offset=\"{offset}\"");
                writeln!(file, "<DataArray {attributes} {place}/>")?;
                offset += 8 + data.n_bytes();
            }
            writeln!(file, "</{section}>")?;
        }
        write!(file, "</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_")?;
        for Block { data, .. } in sections.iter().flat_map(|(_, blocks)| blocks) {
            file.write_all(&(data.n_bytes() as u64).to_le_bytes())?;
            data.write(file)?;
        }
        writeln!(file, "\n</AppendedData>\n</VTKFile>")
    }
}

/// A collection of files over time, in s.
pub(super) fn write_collection(
    file: &mut impl Write,
    frames: impl IntoIterator<Item = (f64, String)>,
) -> io::Result<()> {
    writeln!(
        file,
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" \
         byte_order=\"LittleEndian\">\n<Collection>"
    )?;
    for (time_s, name) in frames {
        writeln!(file, "<DataSet timestep=\"{time_s}\" part=\"0\" file=\"{}\"/>", text(&name))?;
    }
    writeln!(file, "</Collection>\n</VTKFile>")
}

/// A name as the value of an attribute.
fn text(name: &str) -> String {
    let mut text = String::with_capacity(name.len());
    for character in name.chars() {
        match character {
            '&' => text.push_str("&amp;"),
            '<' => text.push_str("&lt;"),
            '>' => text.push_str("&gt;"),
            '"' => text.push_str("&quot;"),
            other => text.push(other),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_core::mesh::{MeshFormat, MeshLimits, read};

    #[test]
    fn what_is_written_is_read_again() {
        let points = [[0.0, 0.0, 0.0], [1.0 / 3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let vectors = [("a \"<mode>\" & more".to_owned(), points.as_flattened())];
        let grid = Grid {
            points: &points,
            tets: &[[0, 1, 2, 3]],
            labels: Some(&[-(1 << 40)]),
            vectors: &vectors,
        };
        let mut bytes = Vec::new();
        grid.write(&mut bytes).unwrap();
        let limits = MeshLimits { max_vertices: 10, max_tets: 10 };
        let mesh = read(&bytes, MeshFormat::VtkXml, &limits).unwrap().mesh;
        assert_eq!(mesh.vertices(), points);
        assert_eq!(
            (mesh.tets(), mesh.labels()),
            ([[0, 1, 2, 3]].as_slice(), [-(1 << 40)].as_slice())
        );
    }
}
