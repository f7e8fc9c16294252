//! What is fuzzed: everything that reads bytes from outside. Each target takes any bytes and must neither
//! panic, nor hang, nor allocate more than it was given; whatever it accepts must also be what it says.
//!
//! `tests/fuzz/run` runs them under libFuzzer; `cargo test -p sutura-fuzz` replays the corpora, so that what
//! was found once stays fixed.

// The daemon is no library: its readers of files come in by their path.
#[allow(dead_code, unused_imports)]
#[path = "../../src/daemon/config/mod.rs"]
mod config;
#[allow(dead_code)]
#[path = "../../src/daemon/keys/file.rs"]
mod key_file;

use sutura_core::mesh::{MeshFile, MeshFormat, MeshLimits, NamedFile, read, read_files};
use sutura_objects::testing::read_object;
use sutura_proto::frame::Frame;
use sutura_proto::state::StateFrame;
use sutura_proto::{keys, npy};
use sutura_store::testing as store;
use sutura_transport::testing as transport;

/// A target: its name, which is that of its corpus, and what it does with bytes.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: [Target; 15] = [
    ("gmsh", gmsh),
    ("vega", vega),
    ("vtk_legacy", vtk_legacy),
    ("vtk_xml", vtk_xml),
    ("tetgen", tetgen),
    ("frame", frame),
    ("state", state),
    ("json", json),
    ("bincode", bincode),
    ("journal", journal),
    ("records", records),
    ("mesh_blob", mesh_blob),
    ("body", body),
    ("settings", settings),
    ("object", object),
];

/// Those of a daemon.
const LIMITS: MeshLimits = MeshLimits { max_vertices: 500_000, max_tets: 2_000_000 };

fn must<T, E: std::fmt::Display>(result: Result<T, E>, what: &str) -> T {
    result.unwrap_or_else(|error| panic!("{what}: {error}"))
}

/// Splits the input where one file or text ends and the next begins.
const SEPARATOR: u8 = 0xff;

fn split(bytes: &[u8]) -> (&[u8], &[u8]) {
    match bytes.iter().position(|&byte| byte == SEPARATOR) {
        Some(at) => (&bytes[..at], &bytes[at + 1..]),
        None => (bytes, &[]),
    }
}

/// A mesh that was accepted is within the limits, and all of it can be used.
fn check(file: &MeshFile) {
    let mesh = &file.mesh;
    let n_vertices = mesh.vertices().len();
    assert!(n_vertices <= LIMITS.max_vertices && mesh.tets().len() <= LIMITS.max_tets);
    assert!(mesh.vertices().iter().flatten().all(|x| x.is_finite()));
    assert!(mesh.tets().iter().flatten().all(|&v| (v as usize) < n_vertices));
    assert!(file.materials.values().all(|material| material.density_kg_m3() > 0.0));
}

fn mesh(bytes: &[u8], format: MeshFormat) {
    if let Ok(file) = read(bytes, format, &LIMITS) {
        check(&file);
    }
}

/// Gmsh's .msh.
pub fn gmsh(bytes: &[u8]) {
    mesh(bytes, MeshFormat::Gmsh);
}

/// Vega's .veg.
pub fn vega(bytes: &[u8]) {
    mesh(bytes, MeshFormat::Vega);
}

/// VTK's .vtk.
pub fn vtk_legacy(bytes: &[u8]) {
    mesh(bytes, MeshFormat::VtkLegacy);
}

/// VTK's .vtu.
pub fn vtk_xml(bytes: &[u8]) {
    mesh(bytes, MeshFormat::VtkXml);
}

/// TetGen's .node and .ele.
pub fn tetgen(bytes: &[u8]) {
    let (nodes, tets) = split(bytes);
    let file = |name, bytes| NamedFile { name: Some(name), bytes };
    if let Ok(file) = read_files(&[file("a.node", nodes), file("a.ele", tets)], &LIMITS) {
        check(&file);
    }
}

/// Frames of arrays, and .npy files, which say the same again when they are written.
pub fn frame(bytes: &[u8]) {
    if let Ok(frame) = Frame::decode(bytes) {
        assert!(frame.arrays.iter().all(|array| array.is_consistent()));
        let again = must(frame.encode(), "a frame that was read can be written");
        let again = must(Frame::decode(&again), "a frame that was written can be read");
        assert_eq!(again.generation, frame.generation);
        let bytes = |frame: &Frame<'_>| -> Vec<Vec<u8>> {
            frame.arrays.iter().map(|array| array.data.bytes().to_vec()).collect()
        };
        // Bytes, since what is not a number equals nothing.
        assert_eq!(bytes(&again), bytes(&frame));
    }
    if let Ok(array) = npy::decode("array", bytes) {
        assert!(array.is_consistent());
        let again = must(npy::encode(&array), "an array that was read can be written");
        let again = must(npy::decode("array", &again), "an array that was written can be read");
        assert_eq!((again.shape, again.data.bytes()), (array.shape, array.data.bytes()));
    }
}

/// Published states, and key expressions.
pub fn state(bytes: &[u8]) {
    if let Ok(state) = StateFrame::decode(bytes) {
        assert!(state.q.iter().all(|q| q.is_finite()) && state.time_s.is_finite());
        let again = must(state.encode(), "a state that was read can be written");
        assert_eq!(again, bytes);
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        if let Some((id, resource)) = keys::parse_session(text) {
            assert_eq!(keys::session(id, resource).as_deref(), Some(text));
        }
        if let Some(id) = keys::parse_daemon(text) {
            assert_eq!(keys::daemon(id).as_deref(), Some(text));
        }
    }
}

/// JSON bodies of every kind, which the first byte chooses, up to the store.
pub fn json(bytes: &[u8]) {
    if let [kind, document @ ..] = bytes {
        transport::take_json(*kind, document);
    }
}

/// The same for bincode bodies.
pub fn bincode(bytes: &[u8]) {
    if let [kind, document @ ..] = bytes {
        transport::take_bincode(*kind, document);
    }
}

/// A journal as it lies on a disk.
pub fn journal(bytes: &[u8]) {
    store::read_journal(bytes);
}

/// Parts of bytes: each is a length (u16, little-endian) and as many bytes.
pub fn parts(bytes: &[u8]) -> Vec<&[u8]> {
    let mut rest = bytes;
    let mut parts = Vec::new();
    while let Some((length, behind)) = rest.split_first_chunk::<2>() {
        let length = usize::from(u16::from_le_bytes(*length)).min(behind.len());
        let (part, behind) = behind.split_at(length);
        parts.push(part);
        rest = behind;
    }
    parts
}

/// A journal whose checksums are right, whatever its records say.
pub fn records(bytes: &[u8]) {
    let journal: Vec<u8> = parts(bytes).into_iter().flat_map(store::framed).collect();
    store::read_journal(&journal);
}

/// A prepared body of the data directory, its checksums right, whatever it says. The first byte tells whether it is
/// a base body or a generation.
pub fn body(bytes: &[u8]) {
    if let [kind, contents @ ..] = bytes {
        store::revive_body(kind % 2 == 0, &parts(contents));
    }
}

/// A mesh of the data directory, with its checksum right.
pub fn mesh_blob(bytes: &[u8]) {
    store::read_mesh(bytes);
}

/// The configuration file, and the file of keys.
pub fn settings(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = config::Config::parse(text);
        if let Ok(entries) = key_file::parse(text) {
            assert!(entries.iter().all(|entry| entry.hash().is_some()));
        }
    }
}

/// A journal's object in an object store, which says the same again when it is written.
pub fn object(bytes: &[u8]) {
    if let Some((header, records)) = read_object(bytes) {
        assert!(bytes.ends_with(records));
        let again = [&header[..], records].concat();
        assert_eq!(read_object(&again), Some((header, records)));
    }
}
