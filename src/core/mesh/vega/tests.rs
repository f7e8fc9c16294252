use crate::material::Material;
use crate::mesh::{MeshError, MeshFile, MeshFormat, MeshLimits, ReadError, ReadFault, read};

const LIMITS: MeshLimits = MeshLimits { max_vertices: 1000, max_tets: 1000 };

fn read_file(text: &str) -> Result<MeshFile, ReadError> {
    read(text.as_bytes(), MeshFormat::Vega, &LIMITS)
}

const TWO_TETS: &str = "# two tets, two materials\n*VERTICES\n5 3 0 0\n\
    1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 0 0 -1 # the lowest\n\n\
    *ELEMENTS\nTET\n2 4 0\n1 1 2 3 4\n2 1 3 2 5\n\n\
    *SET upper\n1,\n# and now the other one\n*SET lower\n2\n\
    *MATERIAL hard\nENU, 1000, 2.5e7, 0.45\n*MATERIAL unused\nENU, 1, 1, 0\n\
    *MATERIAL soft\nENU, 900, 2.5E5, 0.35\n\
    *REGION\nlower, hard\n*REGION\nupper, soft\n";

fn edited(from: &str, to: &str) -> ReadError {
    assert!(TWO_TETS.contains(from));
    read_file(&TWO_TETS.replace(from, to)).unwrap_err()
}

#[test]
fn sets_regions_and_materials_become_domains() {
    let file = read_file(TWO_TETS).unwrap();
    assert_eq!(file.mesh.tets(), [[0, 1, 2, 3], [0, 2, 1, 4]]);
    assert_eq!(file.mesh.labels(), [2, 0]);
    let hard = Material::stvk(2.5e7, 0.45, 1000.0).unwrap();
    let soft = Material::stvk(2.5e5, 0.35, 900.0).unwrap();
    assert_eq!(file.materials.into_iter().collect::<Vec<_>>(), [(0, hard), (2, soft)]);
}

#[test]
fn line_ends_and_the_first_number_do_not_matter() {
    let expected = read_file(TWO_TETS).unwrap();
    assert_eq!(read_file(&TWO_TETS.replace('\n', "\r\n")).unwrap(), expected);
    let zero_based = TWO_TETS
        .replace(
            "1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 0 0 -1",
            "0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 0 0 -1",
        )
        .replace("1 1 2 3 4\n2 1 3 2 5", "0 0 1 2 3\n1 0 2 1 4")
        .replace("upper\n1,", "upper\n0,")
        .replace("lower\n2", "lower\n1");
    assert_eq!(read_file(&zero_based).unwrap(), expected);
}

#[test]
fn a_file_without_regions_is_one_domain() {
    let head = &TWO_TETS[..TWO_TETS.find("*SET upper").unwrap()];
    let file = read_file(head).unwrap();
    assert_eq!((file.mesh.domains(), file.materials.len()), (&[0][..], 0));
    let file = read_file(&format!("{head}*MATERIAL m\nENU, 1000, 1e6, 0.4\n")).unwrap();
    assert_eq!((file.mesh.domains(), file.materials.len()), (&[0][..], 1));
}

#[test]
fn files_of_vegafem_are_read_or_refused() {
    let bytes = include_bytes!("../../../../tests/data/formats/beam3_tet.veg");
    let file = read(bytes, MeshFormat::Vega, &LIMITS).unwrap();
    assert_eq!((file.mesh.vertices().len(), file.mesh.tets().len()), (208, 450));
    assert_eq!(file.materials[&0], Material::stvk(1e7, 0.45, 1000.0).unwrap());

    let cubes = include_bytes!("../../../../tests/data/formats/beam3.veg");
    assert_eq!(
        read(cubes, MeshFormat::Vega, &LIMITS).unwrap_err().to_string(),
        "line 216: elements of type CUBIC are not supported, only TET"
    );
}

#[test]
fn faults_are_located() {
    for (from, to, message) in [
        ("2 1 0 0", "2 1 x 0", "line 5: expected a coordinate, found “x”"),
        ("2 1 0 0", "2 1 0", "line 5: expected a coordinate, found the end of the line"),
        ("2 1 0 0", "7 1 0 0", "line 5: the vertex number is 7 where 2 should come"),
        ("1 0 0 0", "3 0 0 0", "line 4: the vertex number of the first one is 3, neither 0 nor 1"),
        ("2 1 3 2 5", "2 1 3 2 6", "line 14: element 2: vertex 6 is not among 1 to 5"),
        ("2 1 3 2 5", "2 1 3 2 0", "line 14: element 2: vertex 0 is not among 1 to 5"),
        ("lower\n2", "lower\n3", "line 20: set lower: there is no element 3"),
        ("lower\n2", "lower\n", "line 14: element 2 belongs to no *REGION"),
        ("upper, soft", "upper, stiff", "line 30: there is no material stiff"),
        ("upper, soft", "middle, soft", "line 30: there is no set middle"),
        ("upper, soft", "lower, soft", "line 30: set lower is in two regions"),
        ("*MATERIAL soft", "*MATERIAL hard", "line 25: material hard is defined twice"),
        (
            "ENU, 900",
            "MOONEYRIVLIN, 900",
            "line 26: materials of type MOONEYRIVLIN are not supported, only ENU",
        ),
        (
            "*SET upper",
            "*INCLUDE more.veg",
            "line 16: *INCLUDE is not supported: put the included lines into this file",
        ),
        ("*SET upper", "*GROUP upper", "line 16: *GROUP is not supported"),
        (
            "*ELEMENTS",
            "ELEMENTS",
            "line 10: expected a keyword (*VERTICES, *ELEMENTS, …), found “ELEMENTS”",
        ),
    ] {
        assert_eq!(edited(from, to).to_string(), message);
    }
    let inverted = edited("2 1 3 2 5", "2 1 2 3 5");
    assert!(matches!(
        &inverted.fault,
        ReadFault::Mesh { item, error: MeshError::Inverted { tet: 1, .. } } if item == "element 2"
    ));
    let material = edited("ENU, 900, 2.5E5, 0.35", "ENU, 900, 2.5E5, 0.5");
    assert_eq!(
        material.to_string(),
        "line 26: material soft: poisson_ratio must lie strictly between -1 and 0.5, not 0.5"
    );
}

#[test]
fn declared_counts_are_checked_before_allocation() {
    let over = edited("5 3 0 0", "1001 3 0 0");
    assert!(matches!(over.fault, ReadFault::OverLimit { declared: 1001, limit: 1000, .. }));
    let more_than_bytes = edited("2 4 0", "1000 4 0");
    assert!(matches!(more_than_bytes.fault, ReadFault::Truncated { declared: 1000, .. }));
}
