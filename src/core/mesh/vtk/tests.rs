use crate::mesh::{
    Location, MeshFormat, MeshLimits, NamedFile, ReadError, ReadFault, SourceError, TetMesh, read,
    read_files,
};

const LIMITS: MeshLimits = MeshLimits { max_vertices: 100, max_tets: 100 };

macro_rules! file {
    ($name:literal) => {
        ($name, include_bytes!(concat!("../../../../tests/data/formats/", $name)).as_slice())
    };
}

/// The same mesh in every form, by meshio and by VTK itself: 12 points, 12 tets of two domains, and two
/// triangles.
pub(in crate::mesh) const FILES: [(&str, &[u8]); 14] = [
    file!("two_boxes_v42_ascii.vtk"),
    file!("two_boxes_v42_binary.vtk"),
    file!("two_boxes_v51_ascii.vtk"),
    file!("two_boxes_v51_binary.vtk"),
    file!("two_boxes_vtk_ascii.vtk"),
    file!("two_boxes_vtk_binary.vtk"),
    file!("two_boxes_ascii.vtu"),
    file!("two_boxes_inline.vtu"),
    file!("two_boxes_inline_zlib.vtu"),
    file!("two_boxes_inline_big_endian.vtu"),
    file!("two_boxes_appended_raw.vtu"),
    file!("two_boxes_appended_raw_zlib.vtu"),
    file!("two_boxes_appended_base64.vtu"),
    file!("two_boxes_appended_base64_zlib.vtu"),
];

fn format(name: &str) -> MeshFormat {
    MeshFormat::from_file_name(name).unwrap()
}

fn of(name: &str) -> (MeshFormat, &'static [u8]) {
    let (name, bytes) = FILES.iter().find(|(found, _)| *found == name).unwrap();
    (format(name), bytes)
}

#[test]
fn every_form_holds_the_same_mesh() {
    let (_, reference) = FILES[0];
    let reference = read(reference, MeshFormat::VtkLegacy, &LIMITS).unwrap().mesh;
    assert_eq!((reference.vertices().len(), reference.tets().len()), (12, 12));
    assert_eq!(reference.domains(), [3, 5]);
    assert_eq!(reference.labels()[..6], [3; 6]);
    let third = 1.0 / 3.0;
    assert_eq!(reference.vertices()[5], [2.0 / 8.0 + third, 1.0 / 8.0 + third, third]);
    for (name, bytes) in FILES {
        let mesh =
            read(bytes, format(name), &LIMITS).unwrap_or_else(|e| panic!("{name}: {e}")).mesh;
        assert_eq!(mesh.tets(), reference.tets(), "{name}");
        assert_eq!(mesh.labels(), reference.labels(), "{name}");
        // Texts of .vtu files, and VTK's own, have eleven digits.
        let tolerance = if name.contains("ascii") { 1e-10 } else { 0.0 };
        for (found, expected) in mesh.vertices().iter().zip(reference.vertices()) {
            let error = (0..3).map(|i| (found[i] - expected[i]).abs()).fold(0.0, f64::max);
            assert!(error <= tolerance, "{name}: {error:e}");
        }
        assert_eq!(MeshFormat::sniff(bytes), Some(format(name)), "{name}");
        let named = NamedFile { name: None, bytes };
        assert_eq!(read_files(&[named], &LIMITS).unwrap().mesh, mesh, "{name}");
    }
}

fn edited(name: &str, from: &str, to: &str) -> ReadError {
    let (format, bytes) = of(name);
    let text = String::from_utf8(bytes.to_vec()).unwrap();
    assert!(text.contains(from), "{name} has no {from}");
    read(text.replacen(from, to, 1).as_bytes(), format, &LIMITS).unwrap_err()
}

#[test]
fn faults_are_found_where_they_are() {
    let text = "two_boxes_v42_ascii.vtk";
    let error = edited(text, "POINTS 12", "POINTS 13");
    assert!(matches!(error.fault, ReadFault::Unexpected { .. }), "{error}");
    let error = edited(text, "POINTS 12", "POINTS 101");
    assert!(matches!(error.fault, ReadFault::OverLimit { declared: 101, limit: 100, .. }));
    assert_eq!(error.location, Location::Line(5));
    let error = edited(text, "UNSTRUCTURED_GRID", "POLYDATA");
    assert!(error.to_string().contains("POLYDATA"), "{error}");
    let error = edited(text, "CELL_TYPES 14\n5\n5\n10", "CELL_TYPES 14\n5\n5\n12");
    assert!(error.to_string().contains("cell 2 is of type 12"), "{error}");
    let xml = "two_boxes_ascii.vtu";
    let error = edited(xml, "NumberOfCells=\"14\"", "NumberOfCells=\"15\"");
    assert!(error.to_string().contains("offsets holds 14 numbers, not 15"), "{error}");
    let error = edited(xml, "NumberOfPoints=\"12\"", "NumberOfPoints=\"many\"");
    assert!(error.to_string().contains("“many”"), "{error}");
    let error = edited(xml, "</Cells>", "</Cels>");
    assert!(error.to_string().contains("XML"), "{error}");
    let error = edited(xml, "type=\"UnstructuredGrid\"", "type=\"PolyData\"");
    assert!(error.to_string().contains("PolyData"), "{error}");
    let compressed = "two_boxes_inline_zlib.vtu";
    let error = edited(compressed, "vtkZLibDataCompressor", "vtkLZ4DataCompressor");
    assert!(error.to_string().contains("LZ4"), "{error}");
    let error = edited("two_boxes_inline.vtu", "format=\"binary\">\n", "format=\"binary\">\n!!!!");
    assert!(error.to_string().contains("base64"), "{error}");
    let error = edited("two_boxes_appended_base64.vtu", "offset=\"0\"", "offset=\"99999\"");
    assert!(error.to_string().contains("99999"), "{error}");
}

#[test]
fn a_small_file_cannot_ask_for_much() {
    // Two zlib blocks of 4 GiB each are announced.
    let bytes = |words: &[u32]| -> Vec<u8> { words.iter().flat_map(|w| w.to_le_bytes()).collect() };
    use base64::Engine;
    let header = base64::engine::general_purpose::STANDARD.encode(bytes(&[
        2,
        u32::MAX,
        u32::MAX,
        8,
        8,
        0,
        0,
        0,
        0,
    ]));
    let array = |name: &str| {
        format!(
            "<DataArray type=\"Float64\" Name=\"{name}\" format=\"binary\">{header}</DataArray>"
        )
    };
    let file = format!(
        "<VTKFile type=\"UnstructuredGrid\" compressor=\"vtkZLibDataCompressor\"><UnstructuredGrid>\
         <Piece NumberOfPoints=\"4\" NumberOfCells=\"1\"><Points>{}</Points><Cells>{}{}{}</Cells></Piece>\
         </UnstructuredGrid></VTKFile>",
        array("Points"),
        array("offsets"),
        array("types"),
        array("connectivity")
    );
    let error = read(file.as_bytes(), MeshFormat::VtkXml, &LIMITS).unwrap_err();
    assert!(error.to_string().contains("more than the 8 bytes"), "{error}");
    let n = u64::MAX.to_string();
    for section in [
        format!("POINTS {n} double\n"),
        format!("CELLS {n} {n}\n"),
        format!("CELL_TYPES {n}\n"),
        format!("CELL_DATA {n}\n"),
        format!("CELL_DATA 1\nFIELD f 1\ndomain {n} {n} int\n"),
    ] {
        for form in ["ASCII", "BINARY"] {
            let file = format!(
                "# vtk DataFile Version 3.0\nt\n{form}\nDATASET UNSTRUCTURED_GRID\n{section}1 2 3\n"
            );
            let error = read(file.as_bytes(), MeshFormat::VtkLegacy, &LIMITS).unwrap_err();
            assert!(matches!(error.fault, ReadFault::OverLimit { .. }), "{error}");
        }
    }
}

#[test]
fn labels_may_be_scalars_with_or_without_a_table() {
    let grid = "# vtk DataFile Version 2.0\none tet\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n\
        0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n";
    let mesh = |data: &str| -> Result<TetMesh, ReadError> {
        let file = format!("{grid}{data}");
        Ok(read(file.as_bytes(), MeshFormat::VtkLegacy, &LIMITS)?.mesh)
    };
    assert_eq!(mesh("").unwrap().labels(), [0]);
    for scalars in
        ["LOOKUP_TABLE default\n7\n", "7\n", "LOOKUP_TABLE mine\n7\nLOOKUP_TABLE mine 1\n1 1 1 1\n"]
    {
        let data =
            format!("CELL_DATA 1\nSCALARS Material int 1\n{scalars}VECTORS v float\n1 2 3\n");
        assert_eq!(mesh(&data).unwrap().labels(), [7], "{scalars}");
    }
    // The better name wins; numbers of points are no labels.
    let data = "POINT_DATA 4\nSCALARS domain int\n1 1 1 1\nCELL_DATA 1\nFIELD f 2\nregion 1 1 float\n4.0\n\
        domain 1 1 int\n8\n";
    assert_eq!(mesh(data).unwrap().labels(), [8]);
    let error = mesh("CELL_DATA 1\nSCALARS domain float\n1.5\n").unwrap_err();
    assert!(error.to_string().contains("not an integer"), "{error}");
    let error = mesh("CELL_DATA 1\nSCALARS domain nonsense\n1\n").unwrap_err();
    assert!(error.to_string().contains("nonsense"), "{error}");
}

#[test]
fn files_that_do_not_belong_together_are_refused() {
    let (_, bytes) = of("two_boxes_ascii.vtu");
    let named = |name| NamedFile { name: Some(name), bytes };
    let two = [named("a.vtu"), named("b.vtu")];
    assert_eq!(read_files(&two, &LIMITS), Err(SourceError::TooManyFiles));
    assert_eq!(read_files(&[named("a.ele")], &LIMITS), Err(SourceError::HalfTetGen));
    let unknown = NamedFile { name: Some("a.png"), bytes: b"\x89PNG" };
    assert_eq!(read_files(&[unknown], &LIMITS), Err(SourceError::Unknown));
    assert_eq!(read_files(&[], &LIMITS), Err(SourceError::Unknown));
}
