//! A simulation's states as files: motion.pvd with a .vtu for each, and motion.glb.

use super::glb::{Animation, RigidMotion, Scene, Target};
use super::shown::Shown;
use super::vtu::{Grid, write_collection};
use super::{Body, ExportError, Format, Written, file};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::io::Write;
use std::path::{Path, PathBuf};
use sutura_client::proto::state::StateFrame;

/// Most states of one recording.
pub(crate) const MAX_FRAMES: usize = 100_000;

/// States on their way into files.
pub(crate) struct Recording<'a> {
    body: &'a Body,
    folder: &'a Path,
    formats: &'a [Format],
    /// Time and file of each frame.
    frames: Vec<(f64, PathBuf)>,
    states: Vec<StateFrame>,
    /// Of the states whose coordinates belong to the body's basis; others are not in the .glb file.
    generation: u64,
}

impl<'a> Recording<'a> {
    /// `generation` is the one that `body` is of.
    pub(crate) fn new(
        body: &'a Body,
        folder: &'a Path,
        formats: &'a [Format],
        generation: u64,
    ) -> Recording<'a> {
        let (frames, states) = (Vec::new(), Vec::new());
        Recording { body, folder, formats, frames, states, generation }
    }

    pub(crate) fn n_frames(&self) -> usize {
        self.states.len()
    }

    /// Adds a state with its displacement of every vertex, n_vertices × 3, in m.
    pub(crate) fn add(
        &mut self,
        state: StateFrame,
        displacement: &[f32],
    ) -> Result<(), ExportError> {
        if self.states.len() == MAX_FRAMES {
            return Err(ExportError::Unfit(format!("a recording has at most {MAX_FRAMES} states")));
        }
        if self.formats.contains(&Format::Vtu) {
            let (translation, rotation) = placement(&state);
            let u: Vec<f64> = displacement.iter().map(|&x| x.into()).collect();
            let points: Vec<[f64; 3]> = self
                .body
                .mesh
                .vertices()
                .iter()
                .zip(u.as_chunks::<3>().0)
                .map(|(x, u)| {
                    (translation + rotation * (Vector3::from(*x) + Vector3::from(*u))).into()
                })
                .collect();
            let vectors = [("displacement".to_owned(), u.as_slice())];
            let grid = Grid {
                points: &points,
                tets: self.body.mesh.tets(),
                labels: self.body.has_labels.then(|| self.body.mesh.labels()),
                vectors: &vectors,
            };
            let name = format!("motion_{:05}.vtu", self.frames.len());
            file(self.folder, &name, String::new(), &mut Vec::new(), |file| grid.write(file))?;
            self.frames.push((state.time_s, name.into()));
        }
        self.states.push(state);
        Ok(())
    }

    /// Writes what there is one of.
    pub(crate) fn finish(self) -> Result<Vec<Written>, ExportError> {
        let mut written = Vec::new();
        if self.formats.contains(&Format::Vtu) {
            let what = format!("{} deformed shapes over time, motion_*.vtu", self.frames.len());
            let frames = self.frames.iter().map(|(t, path)| (*t, path.display().to_string()));
            file(self.folder, "motion.pvd", what, &mut written, |file| {
                write_collection(file, frames)
            })?;
        }
        if self.formats.contains(&Format::Glb) {
            self.write_glb(&mut written)?;
        }
        Ok(written)
    }

    fn write_glb(&self, written: &mut Vec<Written>) -> Result<(), ExportError> {
        let shown = Shown::of(&self.body.mesh);
        let size = self.body.basis.columns().len();
        let states: Vec<&StateFrame> = self
            .states
            .iter()
            .filter(|state| state.generation == self.generation && state.q.len() == size)
            .collect();
        let Some(first) = states.first() else {
            return Ok(());
        };
        let targets = self
            .body
            .basis
            .columns()
            .enumerate()
            .map(|(i, column)| Target { name: format!("q{i}"), offsets: shown.pick(column, 1.0) })
            .collect();
        let (translations, rotations) = states
            .iter()
            .map(|state| {
                let (t, r) = placement(state);
                let (t, r) = (t.cast::<f32>(), r.coords.cast::<f32>());
                ([t.x, t.y, t.z], [r.x, r.y, r.z, r.w])
            })
            .unzip();
        let animation = Animation {
            name: "motion".to_owned(),
            times_s: states.iter().map(|state| (state.time_s - first.time_s) as f32).collect(),
            weights: states.iter().flat_map(|state| state.q.iter().copied()).collect(),
            rigid: Some(RigidMotion { translations, rotations }),
        };
        let scene = Scene {
            name: &self.body.name,
            positions: shown.positions(),
            normals: shown.normals(),
            triangles: shown.triangles(),
            targets,
            animations: vec![animation],
        };
        let left_out = self.states.len() - states.len();
        let mut what = format!("{} states; the morph targets are the basis", states.len());
        if left_out > 0 {
            what += &format!(", {left_out} states of other generations are left out");
        }
        let bytes = scene.encode()?;
        file(self.folder, "motion.glb", what, written, |file| file.write_all(&bytes))
    }
}

/// Translation in m and rotation.
fn placement(state: &StateFrame) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let [tx, ty, tz, x, y, z, w] = state.rigid;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    (Vector3::new(tx, ty, tz), rotation)
}
