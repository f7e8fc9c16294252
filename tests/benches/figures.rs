//! The figures of \[M16\], each a function of a body, and what they share: a scene to move bodies in.

mod collisions;
mod cubature;
mod locking;
mod rigid_motion;
mod wound;

use crate::bodies::{Body, Failure};
use crate::chart::{self, Curve};
use crate::clock::Clock;
use clap::ValueEnum;
use serde::Serialize;
use serde_json::json;
use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;
use sutura_core::build::{self, Artifacts, BuildParams, Method, RayleighDamping, RebuildParams};
use sutura_core::reduced::{
    EvaluatorTables, Integrator, ReducedModel, Simulation, SimulationParams, VertexRows,
};
use sutura_picture::{Album, Picture};

/// Relative eigenvalue error of rebuilt modes: the daemon's default.
const TOLERANCE: f64 = 1e-4;

/// Weak damping, so that motions go on while they are looked at.
const DAMPING: RayleighDamping = RayleighDamping { mass_per_s: 0.5, stiffness_s: 5e-4 };

/// Steps in the period of the slowest mode.
const STEPS_PER_PERIOD: f64 = 60.0;

/// How far gravity would move the body by linear statics, relative to its size: well beyond small motion.
const SAG: f64 = 0.12;

/// Gravity in m/s² that bends no body beyond its linear range.
const TRACE: f64 = 1e-6;

/// A figure of \[M16\].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Figure {
    /// A basis that was not rebuilt locks.
    #[value(name = "1")]
    Locking,
    /// What cubature changes, frame by frame.
    #[value(name = "4")]
    Cubature,
    /// Rigid motions belong to a free domain's basis.
    #[value(name = "7")]
    RigidMotion,
    /// A body that collides.
    #[value(name = "9")]
    Collisions,
    /// A wound closed in part and in full.
    #[value(name = "11")]
    Wound,
}

impl Figure {
    /// In the paper.
    pub(crate) fn number(self) -> u32 {
        match self {
            Figure::Locking => 1,
            Figure::Cubature => 4,
            Figure::RigidMotion => 7,
            Figure::Collisions => 9,
            Figure::Wound => 11,
        }
    }

    /// The body that the paper shows, or the one of the repository's `small` ones that is most like it.
    pub(crate) fn body(self, small: bool) -> &'static str {
        match (self, small) {
            (Figure::Locking, true) => "plant_small",
            (Figure::Locking, false) => "plant",
            (Figure::RigidMotion, true) => "fork_small",
            (Figure::RigidMotion, false) => "fork",
            (Figure::Cubature | Figure::Collisions | Figure::Wound, true) => "stomach_small",
            (Figure::Cubature | Figure::Collisions, false) => "dinosaur",
            (Figure::Wound, false) => "stomach",
        }
    }

    /// Makes the figure and tells what it shows, as Markdown.
    pub(crate) fn show(self, scene: &Scene<'_>) -> Result<String, Failure> {
        let text = match self {
            Figure::Locking => locking::show(scene),
            Figure::Cubature => cubature::show(scene),
            Figure::RigidMotion => rigid_motion::show(scene),
            Figure::Collisions => collisions::show(scene),
            Figure::Wound => wound::show(scene),
        }?;
        let text = format!("## Figure {}: {}\n\n{text}\n", self.number(), scene.body.name);
        std::fs::write(scene.file("md"), &text)?;
        Ok(text)
    }
}

/// What a figure is made from, and where it goes.
pub(crate) struct Scene<'a> {
    figure: Figure,
    body: &'a Body,
    n_frames: usize,
    out: PathBuf,
}

/// How a body moves.
#[derive(Clone, Copy)]
struct Course {
    dt_s: f64,
    gravity_m_s2: [f64; 3],
    integrator: Integrator,
}

/// A model that moves, and how displacements follow from its coordinates.
struct Mover<'a> {
    name: &'a str,
    model: Arc<ReducedModel>,
    /// Of every vertex.
    basis: Vec<Vec<f64>>,
}

impl<'a> Mover<'a> {
    fn new(name: &'a str, built: &Artifacts) -> Mover<'a> {
        Mover { name, model: built.model().clone(), basis: basis(built) }
    }

    /// u = Uq at every vertex, `n_vertices × 3`, in m.
    fn displacement(&self, q: &[f64]) -> Vec<f32> {
        let mut u = vec![0.0; self.basis.first().map_or(0, Vec::len)];
        for (column, q) in self.basis.iter().zip(q) {
            u.iter_mut().zip(column).for_each(|(u, b)| *u += q * b);
        }
        u.into_iter().map(|u| u as f32).collect()
    }

    /// The displacement of every frame.
    fn run(&self, course: Course, n_frames: usize) -> Result<Vec<Vec<f32>>, Failure> {
        let mut simulation = course.start(self.model.clone())?;
        let rest = vec![0.0; self.model.r()];
        Ok((0..n_frames)
            .map(|_| {
                simulation.step(&rest, &[]);
                self.displacement(simulation.q())
            })
            .collect())
    }
}

impl Course {
    fn start(self, model: Arc<ReducedModel>) -> Result<Simulation, Failure> {
        let Course { dt_s, gravity_m_s2, integrator } = self;
        let params = SimulationParams { dt_s, integrator, gravity_m_s2, substep_tolerance: None };
        Ok(Simulation::new(model, params)?)
    }
}

/// The columns of a body's basis.
fn basis(built: &Artifacts) -> Vec<Vec<f64>> {
    (0..built.basis_size()).map(|i| built.basis_column(i)).collect()
}

/// Largest displacement of a frame, in m.
fn reach(displacement: &[f32]) -> f64 {
    let norm = |u: &[f32]| u.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    displacement.chunks_exact(3).map(norm).fold(0.0, f64::max)
}

/// Root mean square difference of two frames, in m.
fn difference(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (3.0 * sum / a.len() as f64).sqrt()
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

/// `tables` with stitches of `stiffness_n_m` on pairs of vertices, after which nothing is free to move rigidly.
fn stitched(
    mut tables: EvaluatorTables,
    pairs: &[[VertexRows; 2]],
    stiffness_n_m: f64,
) -> EvaluatorTables {
    let r = tables.r;
    for [a, b] in pairs {
        for axis in 0..3 {
            let stretch: Vec<f64> =
                a.rows.iter().zip(&b.rows).map(|(a, b)| a[axis] - b[axis]).collect();
            for i in 0..r {
                for j in 0..r {
                    tables.stitch_stiffness[i * r + j] += stiffness_n_m * stretch[i] * stretch[j];
                }
            }
        }
    }
    tables.n_rigid_modes = 0;
    tables
}

impl<'a> Scene<'a> {
    pub(crate) fn new(
        figure: Figure,
        body: &'a Body,
        n_frames: usize,
        out: impl Into<PathBuf>,
    ) -> Scene<'a> {
        Scene { figure, body, n_frames, out: out.into() }
    }

    /// figure_N.EXTENSION, or figure_N_NAME.png when `ending` is NAME.png.
    fn file(&self, ending: &str) -> PathBuf {
        let separator = if ending.contains('.') { '_' } else { '.' };
        self.out.join(format!("figure_{}{separator}{ending}", self.figure.number()))
    }

    /// The body before any stitch.
    fn build(&self, change: impl FnOnce(BuildParams) -> BuildParams) -> Result<Artifacts, Failure> {
        let params = change(BuildParams { damping: DAMPING, ..self.body.session(&[]) });
        Ok(build::build(self.body.mesh.clone(), &params, &Clock::start())?)
    }

    fn stitch(
        &self,
        before: &Artifacts,
        pairs: &[[u32; 2]],
        method: Method,
    ) -> Result<Artifacts, Failure> {
        let params = RebuildParams::new(method, TOLERANCE);
        Ok(build::rebuild(before, &self.body.stitch(pairs), &params, &Clock::start())?.0)
    }

    /// Steps that resolve the slowest mode of `built`, and gravity along −y that would make it sag by [`SAG`].
    fn course(&self, built: &Artifacts) -> Result<Course, Failure> {
        let first = built.frequencies_hz()[built.n_rigid_modes()];
        let mover = Mover::new("", built);
        let model = built.model();
        // Under so little of it statics are linear.
        let load: Vec<f64> =
            (0..model.r()).map(|i| -TRACE * model.gravity_loads()[(i, 1)]).collect();
        let q = model.solve_static(&load, &vec![0.0; load.len()])?;
        let sag = reach(&mover.displacement(&q)) / TRACE;
        let gravity = SAG * built.mesh().diagonal() / sag;
        Ok(Course {
            dt_s: 1.0 / (first * STEPS_PER_PERIOD),
            gravity_m_s2: [0.0, -gravity, 0.0],
            integrator: Integrator::ImplicitNewmark,
        })
    }

    /// Moves `movers` on the same course and holds them against the last: a chart, data and a table.
    fn compare(&self, movers: &[Mover<'_>; 3], course: Course) -> Result<Comparison, Failure> {
        let mut motions = Vec::new();
        for mover in movers {
            motions.push(mover.run(course, self.n_frames)?);
        }
        let reaches: Vec<Vec<f64>> = motions
            .iter()
            .map(|frames| frames.iter().map(|frame| reach(frame)).collect())
            .collect();
        let curves: Vec<Curve> = movers
            .iter()
            .zip(&reaches)
            .map(|(mover, reaches)| over_time(course, mover.name, reaches.iter().copied()))
            .collect();
        self.chart("motion", "largest displacement under gravity", "m", &curves)?;
        self.data(&json!({
            "body": self.body.name, "n_stitches": self.body.stitches.len(), "dt_s": course.dt_s,
            "gravity_m_s2": course.gravity_m_s2,
            "bases": movers.iter().map(|mover| mover.name).collect::<Vec<_>>(),
            "largest_displacement_m": reaches,
        }))?;
        let top = largest(reaches[2].iter().copied());
        let mut text = String::from(
            "| basis | columns | largest displacement, of that from scratch | largest difference of a frame, \
             root mean square, of the largest displacement |\n|---|---|---|---|\n",
        );
        for ((mover, frames), reaches) in movers.iter().zip(&motions).zip(&reaches) {
            let apart = largest(frames.iter().zip(&motions[2]).map(|(a, b)| difference(a, b)));
            text += &format!(
                "| {} | {} | {:.3} | {:.4} |\n",
                mover.name,
                mover.model.r(),
                largest(reaches.iter().copied()) / top,
                apart / top
            );
        }
        let at = farthest(&motions[2]);
        Ok(Comparison { text, at, frames: motions.into_iter().map(|m| m[at].clone()).collect() })
    }

    /// Pictures of the body, all from one side and at one scale.
    fn pictures(&self, built: &Artifacts, pictures: &[Shot<'_>]) -> Result<(), Failure> {
        let all: Vec<&[f32]> = pictures.iter().map(|picture| picture.displacement).collect();
        let mesh = built.mesh();
        let album = Album::new(mesh.vertices(), mesh.tets(), &self.body.stitches, &all);
        for Shot { name, title, caption, displacement, stitches } in pictures {
            let file = File::create(self.file(&format!("{name}.png")))?;
            album.write(&Picture { title, caption, displacement, stitches }, file)?;
        }
        Ok(())
    }

    /// Curves over time.
    fn chart(&self, name: &str, title: &str, y: &str, curves: &[Curve]) -> Result<(), Failure> {
        let of = |axis: fn(&(f64, f64)) -> f64| curves.iter().flat_map(|c| &c.points).map(axis);
        let (right, top) = (largest(of(|p| p.0)), largest(of(|p| p.1)));
        let range = (0.0..right.max(1e-9), 0.0..(1.05 * top).max(1e-9));
        let title = format!("{}: {title}", self.body.name);
        chart::chart(&self.file(&format!("{name}.svg")), &title, ["s", y], range, curves)
    }

    fn data(&self, data: &impl Serialize) -> Result<(), Failure> {
        Ok(std::fs::write(self.file("json"), serde_json::to_vec_pretty(data)?)?)
    }
}

/// What three movers have done.
struct Comparison {
    /// As a table.
    text: String,
    /// The frame in which the last of them reached farthest.
    at: usize,
    /// All of them in that frame.
    frames: Vec<Vec<f32>>,
}

/// A picture to be taken.
struct Shot<'a> {
    name: &'a str,
    title: &'a str,
    caption: &'a str,
    displacement: &'a [f32],
    stitches: &'a [[u32; 2]],
}

/// Values over time: the frames of a course.
fn over_time(course: Course, name: &str, values: impl IntoIterator<Item = f64>) -> Curve {
    let points = values.into_iter().enumerate();
    Curve::new(name, points.map(|(i, y)| ((i + 1) as f64 * course.dt_s, y)).collect())
}

/// The frame of `frames` in which the body reaches farthest.
fn farthest(frames: &[Vec<f32>]) -> usize {
    let reaches: Vec<f64> = frames.iter().map(|frame| reach(frame)).collect();
    let best = (0..frames.len()).max_by(|&a, &b| reaches[a].total_cmp(&reaches[b]));
    best.unwrap_or(0)
}
