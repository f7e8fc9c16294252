//! Figure 9: a stitched body swings into a ball and falls onto a floor.

use super::{Course, Mover, Scene, Shot, farthest, largest, over_time, reach};
use crate::bodies::Failure;
use serde_json::json;
use std::sync::Arc;
use sutura_core::build::{Artifacts, Method};
use sutura_core::reduced::contact::Obstacle;
use sutura_core::reduced::{Environment, Integrator};

/// Radii tried for the ball, of the body's size: the largest that touches nothing at rest.
const RADII: [f64; 5] = [0.1, 0.08, 0.06, 0.04, 0.02];

/// Where the ball waits, of the way that the vertex that reaches farthest takes without it.
const ON_THE_WAY: [f64; 3] = [0.3, 0.5, 0.7];

/// How far the lowest point may sink before it meets the floor, of that way.
const FALL: f64 = 0.7;

pub(crate) fn show(scene: &Scene<'_>) -> Result<String, Failure> {
    let pairs = &scene.body.stitches;
    let before = scene.build(|params| params)?;
    let built = scene.stitch(&before, pairs, Method::Flexibility)?;
    let course = Course { integrator: Integrator::BackwardEuler, ..scene.course(&built)? };
    let mover = Mover::new("", &built);
    let free = mover.run(course, scene.n_frames)?;
    let obstacles = obstacles(&built, &free[farthest(&free)])?;

    let mut simulation = course.start(mover.model.clone())?;
    let contact = built.suited_contact();
    simulation.set_environment(
        Some(Arc::new(Environment { obstacles: obstacles.to_vec(), contact })),
        Some(built.contact_surface().clone()),
    );
    let rest = vec![0.0; mover.model.r()];
    let (mut frames, mut forces, mut depths, mut n_recovered) = (vec![], vec![], vec![], 0);
    for _ in 0..scene.n_frames {
        n_recovered += u32::from(simulation.step(&rest, &[]).recovered);
        let displacement = mover.displacement(simulation.q());
        let force = simulation.interaction_force_n();
        forces.push(force.iter().map(|f| f * f).sum::<f64>().sqrt());
        depths.push(depth(&built, &obstacles, &displacement));
        frames.push(displacement);
    }
    let depths_free: Vec<f64> = free.iter().map(|u| depth(&built, &obstacles, u)).collect();
    scene.chart(
        "force",
        "force of the obstacles",
        "N",
        &[over_time(course, "", forces.clone())],
    )?;
    let mm = |depths: &[f64]| depths.iter().map(|d| 1e3 * d).collect::<Vec<f64>>();
    scene.chart(
        "depth",
        "deepest vertex in an obstacle",
        "mm",
        &[
            over_time(course, "with collisions", mm(&depths)),
            over_time(course, "without", mm(&depths_free)),
        ],
    )?;
    let most = (0..forces.len()).max_by(|&a, &b| forces[a].total_cmp(&forces[b])).unwrap_or(0);
    let at = farthest(&free);
    let mut pictures = vec![Shot {
        name: "a_without",
        title: "without obstacles",
        caption: "",
        displacement: &free[at],
        stitches: pairs,
    }];
    for (name, title, frame) in [
        ("b_with", "with a ball and a floor, at the same time", at),
        ("c_pressed", "pressed hardest", most),
    ] {
        let displacement = &frames[frame];
        pictures.push(Shot { name, title, caption: "", displacement, stitches: pairs });
    }
    scene.pictures(&built, &pictures)?;
    scene.data(&json!({
        "body": scene.body.name, "dt_s": course.dt_s, "gravity_m_s2": course.gravity_m_s2,
        "obstacles": obstacles.iter().map(|o| format!("{o:?}")).collect::<Vec<_>>(),
        "force_n": forces, "depth_m": depths, "depth_without_m": depths_free,
    }))?;
    let weight = -course.gravity_m_s2[1] * built.lumped_mass_kg().iter().sum::<f64>();
    let size = built.mesh().diagonal();
    Ok(format!(
        "{} frames, {n_recovered} undone. Largest force of the obstacles: {:.2} of the weight. Deepest vertex: {:.2} % of \
         the body's size; {:.2} % without contact. Largest displacement {:.1} % of the size ({:.1} % without).\n",
        frames.len(),
        largest(forces) / weight,
        100.0 * largest(depths) / size,
        100.0 * largest(depths_free) / size,
        100.0 * largest(frames.iter().map(|u| reach(u))) / size,
        100.0 * largest(free.iter().map(|u| reach(u))) / size,
    ))
}

/// A ball in the way of the vertex that `swung` moves farthest, and a floor.
fn obstacles(built: &Artifacts, swung: &[f32]) -> Result<[Obstacle; 2], Failure> {
    let (mesh, size) = (built.mesh(), built.mesh().diagonal());
    let moved = |v: usize| swung[3 * v..][..3].iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
    let n = mesh.vertices().len();
    let vertex = (0..n).max_by(|&a, &b| moved(a).total_cmp(&moved(b))).unwrap_or(0);
    let way = moved(vertex).sqrt();
    let rest = vec![0.0; swung.len()];
    let ball = |radius_m: f64, share: f64| {
        let center_m = std::array::from_fn(|axis| {
            let direction = f64::from(swung[3 * vertex + axis]) / way;
            mesh.vertices()[vertex][axis] + direction * (share * way + radius_m)
        });
        Obstacle::Sphere { center_m, radius_m }
    };
    let mut balls = RADII
        .iter()
        .flat_map(|radius| ON_THE_WAY.map(|share| ball(radius * size, share)))
        .filter(|ball| depth(built, std::slice::from_ref(ball), &rest) <= 0.0);
    let ball = balls.next().ok_or("no ball fits in the way of this body")?;
    let lowest = |at: &dyn Fn(usize) -> f64| (0..n).map(at).fold(f64::INFINITY, f64::min);
    let high = lowest(&|v| mesh.vertices()[v][1]);
    let low = lowest(&|v| mesh.vertices()[v][1] + f64::from(swung[3 * v + 1]));
    let floor = high + FALL * (low - high);
    Ok([ball, Obstacle::Plane { point_m: [0.0, floor, 0.0], normal: [0.0, 1.0, 0.0] }])
}

/// How deep the deepest vertex that can move is in an obstacle, in m.
fn depth(built: &Artifacts, obstacles: &[Obstacle], u: &[f32]) -> f64 {
    let place = |v: u32| -> [f64; 3] {
        std::array::from_fn(|axis| {
            let v = v as usize;
            built.mesh().vertices()[v][axis] + f64::from(u[3 * v + axis])
        })
    };
    let into = |obstacle: &Obstacle, x: [f64; 3]| match obstacle {
        Obstacle::Plane { point_m, .. } => point_m[1] - x[1],
        Obstacle::Sphere { center_m, radius_m } => {
            let apart = center_m.iter().zip(x).map(|(c, x)| (x - c).powi(2)).sum::<f64>();
            radius_m - apart.sqrt()
        }
        Obstacle::Capsule { .. } => f64::NEG_INFINITY,
    };
    let vertices = built.full_model().free_vertices().iter();
    largest(vertices.flat_map(|&v| obstacles.iter().map(move |o| into(o, place(v)))))
}
