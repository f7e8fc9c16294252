//! Binary glTF 2.0: a triangle mesh with morph targets, and animations of their weights and of the node.
//!
//! Positions are in metres; the axes are the mesh's own (glTF's viewers show y upwards). u = U q is exact:
//! the targets are columns of U and the weights are q.

use super::error::ExportError;
use serde_json::{Value, json};
use std::f32::consts::TAU;

/// A shape that is added to the mesh, times its weight.
pub(super) struct Target {
    pub(super) name: String,
    /// One for each vertex, in m.
    pub(super) offsets: Vec<[f32; 3]>,
}

/// What moves, and when.
pub(super) struct Animation {
    pub(super) name: String,
    /// Ascending.
    pub(super) times_s: Vec<f32>,
    /// For each time the weights of all targets.
    pub(super) weights: Vec<f32>,
    pub(super) rigid: Option<RigidMotion>,
}

/// For each time where the body is, in m, and how it is turned (quaternion x y z w).
pub(super) struct RigidMotion {
    pub(super) translations: Vec<[f32; 3]>,
    pub(super) rotations: Vec<[f32; 4]>,
}

/// Keys of one swing of a mode.
const N_KEYS: usize = 33;

impl Animation {
    /// One period of target `i` out of `n`, at `frequency_hz`.
    pub(super) fn swinging(name: String, i: usize, n: usize, frequency_hz: f64) -> Animation {
        let period = 1.0 / frequency_hz.max(f64::from(f32::MIN_POSITIVE));
        let mut animation =
            Animation { name, times_s: Vec::new(), weights: vec![0.0; n * N_KEYS], rigid: None };
        for key in 0..N_KEYS {
            let phase = key as f32 / (N_KEYS - 1) as f32;
            animation.times_s.push((f64::from(phase) * period) as f32);
            animation.weights[n * key + i] = (TAU * phase).sin();
        }
        animation
    }
}

/// Everything in one file.
pub(super) struct Scene<'a> {
    pub(super) name: &'a str,
    pub(super) positions: &'a [[f32; 3]],
    pub(super) normals: &'a [[f32; 3]],
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) targets: Vec<Target>,
    pub(super) animations: Vec<Animation>,
}

// glTF's numbers for element types and for what a buffer is used for.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// Data and the JSON that describes it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends numbers of four bytes; returns the accessor's index.
    fn push(&mut self, bytes: &[u8], usage: Option<u32>, mut accessor: Value) -> usize {
        let mut view = json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(),
        });
        if let Some(usage) = usage {
            view["target"] = usage.into();
        }
        accessor["bufferView"] = self.views.len().into();
        self.views.push(view);
        self.accessors.push(accessor);
        self.bytes.extend_from_slice(bytes);
        self.accessors.len() - 1
    }

    fn vectors<const N: usize>(&mut self, vectors: &[[f32; N]], usage: Option<u32>) -> usize {
        let kind = if N == 3 { "VEC3" } else { "VEC4" };
        let mut accessor = json!({"componentType": FLOAT, "count": vectors.len(), "type": kind});
        // Positions must have them, and others may.
        for (name, pick, start) in [
            ("min", f32::min as fn(f32, f32) -> f32, f32::INFINITY),
            ("max", f32::max, f32::NEG_INFINITY),
        ] {
            let bound: Vec<f32> =
                (0..N).map(|axis| vectors.iter().map(|v| v[axis]).fold(start, pick)).collect();
            accessor[name] = bound.into();
        }
        let bytes: Vec<u8> = vectors.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        self.push(&bytes, usage, accessor)
    }

    fn scalars(&mut self, values: &[f32]) -> usize {
        let low = values.iter().copied().fold(f32::INFINITY, f32::min);
        let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let accessor = json!({
            "componentType": FLOAT, "count": values.len(), "type": "SCALAR", "min": [low], "max": [high],
        });
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.push(&bytes, None, accessor)
    }
}

impl Scene<'_> {
    /// The bytes of a .glb file.
    pub(super) fn encode(&self) -> Result<Vec<u8>, ExportError> {
        let mut buffer = Buffer::default();
        let indices: Vec<u8> =
            self.triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
        let n_indices = 3 * self.triangles.len();
        let accessor = json!({"componentType": UNSIGNED_INT, "count": n_indices, "type": "SCALAR"});
        let indices = buffer.push(&indices, Some(INDICES), accessor);
        let positions = buffer.vectors(self.positions, Some(VERTICES));
        let normals = buffer.vectors(self.normals, Some(VERTICES));
        let mut targets = Vec::new();
        for target in &self.targets {
            let offsets = buffer.vectors(&target.offsets, Some(VERTICES));
            targets.push(json!({"POSITION": offsets}));
        }
        let names: Vec<&str> = self.targets.iter().map(|target| target.name.as_str()).collect();
        let mut mesh = json!({
            "name": self.name,
            "primitives": [{
                "attributes": {"POSITION": positions, "NORMAL": normals},
                "indices": indices,
                "material": 0,
            }],
        });
        if !targets.is_empty() {
            mesh["primitives"][0]["targets"] = targets.into();
            mesh["weights"] = vec![0.0f32; names.len()].into();
            mesh["extras"] = json!({"targetNames": names});
        }
        let animations: Vec<Value> =
            self.animations.iter().map(|animation| animate(&mut buffer, animation)).collect();
        let mut document = json!({
            "asset": {"version": "2.0", "generator": concat!("sutura ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": self.name, "mesh": 0}],
            "meshes": [mesh],
            "materials": [{
                "name": "tissue",
                "doubleSided": true,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.85, 0.45, 0.42, 1.0], "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }],
            "accessors": buffer.accessors,
            "bufferViews": buffer.views,
            "buffers": [{"byteLength": buffer.bytes.len()}],
        });
        if !animations.is_empty() {
            document["animations"] = animations.into();
        }
        pack(&document, buffer.bytes)
    }
}

fn animate(buffer: &mut Buffer, animation: &Animation) -> Value {
    let times = buffer.scalars(&animation.times_s);
    let (mut samplers, mut channels) = (Vec::new(), Vec::new());
    let mut channel = |path: &str, output: usize| {
        let sampler = json!({"input": times, "output": output, "interpolation": "LINEAR"});
        channels.push(json!({"sampler": samplers.len(), "target": {"node": 0, "path": path}}));
        samplers.push(sampler);
    };
    channel("weights", buffer.scalars(&animation.weights));
    if let Some(RigidMotion { translations, rotations }) = &animation.rigid {
        channel("translation", buffer.vectors(translations, None));
        channel("rotation", buffer.vectors(rotations, None));
    }
    json!({"name": animation.name, "samplers": samplers, "channels": channels})
}

/// The header and the two chunks.
fn pack(document: &Value, mut binary: Vec<u8>) -> Result<Vec<u8>, ExportError> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = 12 + 8 + text.len() + 8 + binary.len();
    let Ok(n_bytes) = u32::try_from(length) else {
        let message = "the surface and its modes are more than the 4 GiB of a .glb file";
        return Err(ExportError::Unfit(message.to_owned()));
    };
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(b"glTF");
    bytes.extend_from_slice(&2u32.to_le_bytes());
    bytes.extend_from_slice(&n_bytes.to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_two_chunks_whose_views_fill_the_second() {
        let offsets = vec![[0.0, 0.5, 0.0], [0.0; 3], [0.0; 3]];
        let scene = Scene {
            name: "one triangle",
            positions: &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            normals: &[[0.0, 0.0, 1.0]; 3],
            triangles: &[[0, 1, 2]],
            targets: vec![Target { name: "mode 1".to_owned(), offsets }],
            animations: vec![Animation::swinging("mode 1".to_owned(), 0, 1, 2.0)],
        };
        let bytes = scene.encode().unwrap();
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i])) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (b"glTF".as_slice(), 2, bytes.len()));
        let n_text = word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let document: Value = serde_json::from_slice(&bytes[20..20 + n_text]).unwrap();
        let n_binary = word(20 + n_text);
        assert_eq!(28 + n_text + n_binary, bytes.len());
        let views = document["bufferViews"].as_array().unwrap();
        let sizes = views.iter().map(|view| view["byteLength"].as_u64().unwrap() as usize);
        assert_eq!(sizes.sum::<usize>(), n_binary);
        let accessor = &document["accessors"]
            [document["animations"][0]["samplers"][0]["input"].as_u64().unwrap() as usize];
        assert_eq!(accessor["max"], json!([0.5]));
        assert_eq!(document["meshes"][0]["extras"]["targetNames"], json!(["mode 1"]));
    }
}
