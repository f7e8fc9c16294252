use super::*;
use crate::frame::Frame;
use crate::interaction::{Derivative, Effect, Grab, Interactions, Pull, VertexRows};
use nalgebra::UnitQuaternion;
use std::collections::BTreeMap;
use std::sync::Arc;

const R: usize = 11;

fn number(seed: usize) -> f64 {
    let x = (12.9898 * (seed as f64 + 1.0)).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

/// A sheet of 20 × 20 vertices whose rows vary smoothly over it.
fn sheet() -> ContactSurface {
    let vertices: Vec<SurfaceVertex> = (0..400)
        .map(|v| SurfaceVertex {
            rest_m: [(v % 20) as f64 * 0.05, 0.02 * number(v), (v / 20) as f64 * 0.05],
            area_m2: 0.0025,
        })
        .collect();
    let place = vertices.clone();
    ContactSurface::new(R, &vertices, move |v| {
        let [x, _, z] = place[v].rest_m;
        let wave = |k: usize| ((k as f64 + 1.0) * (x * (1 + k / R) as f64 + 0.7 * z)).sin();
        (0..3 * R).map(|k| (0.3 * wave(k)) as f32).collect()
    })
}

fn obstacles() -> Vec<Obstacle> {
    vec![
        Obstacle::Plane { point_m: [0.0, -0.05, 0.0], normal: [0.1, 2.0, 0.3] },
        Obstacle::Sphere { center_m: [0.4, 0.1, 0.5], radius_m: 0.2 },
        Obstacle::Capsule { from_m: [0.0, -0.1, 0.9], to_m: [0.9, 0.1, 0.6], radius_m: 0.08 },
    ]
}

fn placement() -> Placement {
    Placement {
        frame: Frame {
            position_m: Vector3::new(0.02, -0.01, 0.03),
            rotation: UnitQuaternion::from_euler_angles(0.2, -0.1, 0.15),
        },
        origin: Vector3::new(0.5, 0.0, 0.5),
        velocity: Vector3::new(0.1, -0.4, 0.2),
        omega: Vector3::new(0.3, 0.2, -0.5),
    }
}

fn pose(seed: usize, size: f64) -> Vec<f64> {
    (0..R).map(|k| size * number(31 * seed + k)).collect()
}

#[test]
fn no_vertex_in_an_obstacle_is_missed() {
    let surface = sheet();
    let placement = Placement { origin: Vector3::zeros(), ..placement() };
    let local: Vec<LocalObstacle> = obstacles().iter().map(|o| o.seen_from(&placement)).collect();
    let mut n_found = 0;
    for seed in 0..40 {
        let q = pose(seed, 0.01 * (1 + seed % 8) as f64);
        let mut found = BTreeMap::new();
        surface.touch(&local, &placement, &q, &q, |v, _, touch| {
            *found.entry(v).or_insert(0.0) += touch.depth;
        });
        for v in 0..surface.n_vertices() {
            let y = Vector3::from_fn(|axis, _| {
                let row = &surface.rows(v)[axis * R..][..R];
                surface.rest[v][axis]
                    + row.iter().zip(&q).map(|(a, q)| f64::from(*a) * q).sum::<f64>()
            });
            let x = placement.frame.rotation * y + placement.frame.position_m;
            let world = Placement::fixed();
            let depth: f64 =
                obstacles().iter().map(|o| (-o.seen_from(&world).distance(&x).0).max(0.0)).sum();
            let of_culled = found.get(&v).copied().unwrap_or(0.0);
            // Rows are single precision.
            assert!((depth - of_culled).abs() < 1e-6, "vertex {v}: {depth} {of_culled}");
        }
        n_found += found.len();
    }
    assert!(n_found > 1000 && n_found < 40 * 400, "{n_found}");
}

#[test]
fn forces_of_grabs_and_contact_have_the_stiffness_that_newton_s_method_takes() {
    let surface = sheet();
    let contact = Contact { stiffness_pa_m: 3e6, damping_s_m: 0.6, friction: 0.3, creep_m_s: 1e-2 };
    let vertex = Arc::new(VertexRows {
        rest_m: [0.3, 0.0, 0.2],
        rows: (0..R).map(|k| std::array::from_fn(|a| 0.3 * number(3 * k + a + 900))).collect(),
    });
    let grab = Grab { vertex, target_m: [0.1, 0.4, 0.2], stiffness_n_m: 40.0, damping_n_s_m: 0.7 };
    // Planes: of curved obstacles Newton's method leaves out what would make its matrix indefinite.
    let planes = [obstacles()[0]];
    let grabs = [grab];
    let contact = Some((&surface, contact));
    let interactions =
        Interactions { grabs: &grabs, obstacles: &planes, contact, contact_weight: 2.0 };
    // As often as each counts: force on q, then on the frame.
    let weighted = |pull: &Pull| -> Vec<f64> {
        let all = |effect: &Effect| -> Vec<f64> {
            effect.force.iter().chain(effect.total.iter().flatten()).copied().collect()
        };
        all(&pull.grabs).iter().zip(all(&pull.contact)).map(|(a, b)| a + 2.0 * b).collect()
    };
    let (q, rate) = (pose(3, 0.03), 200.0);
    let derivative = Derivative { rate, of_frame: true };
    let pull = interactions.pull(&placement(), &q, &[0.0; R], Some(derivative));
    assert!(pull.grabs.total[0].norm() > 5.0 && pull.contact.total[0].norm() > 5.0);
    let forces = weighted(&pull);
    let stiffness = pull.stiffness.unwrap();
    // Steps of q and of the frame: forces on both.
    let step: Vec<f64> = (0..R + 6).map(|k| 1e-7 * number(155 + k)).collect();
    let at = |s: f64| {
        let moved: Vec<f64> = q.iter().zip(&step).map(|(q, d)| q + s * d).collect();
        let velocity: Vec<f64> = step[..R].iter().map(|d| s * rate * d).collect();
        let part = |first: usize| Vector3::from_fn(|axis, _| s * step[R + first + axis]);
        let frame = placement().corrected(part(0), part(3), rate);
        weighted(&interactions.pull(&frame, &moved, &velocity, None))
    };
    let (ahead, behind) = (at(1.0), at(-1.0));
    let scale = forces[..R].iter().fold(0.0f64, |m, f| m.max(f.abs()));
    for i in 0..R + 6 {
        let difference = 0.5 * (ahead[i] - behind[i]);
        let exact: f64 = -(0..R + 6).map(|j| stiffness[(i, j)] * step[j]).sum::<f64>();
        // Forces are seen from a frame that turns by 1e-7; beside this what is left is rounding, and
        // vertices that come to touch.
        assert!((difference - exact).abs() < 1e-5 * scale, "{i}: {difference} {exact}");
    }
}

#[test]
fn contact_pushes_out_and_friction_opposes_sliding() {
    let contact = Contact { stiffness_pa_m: 1e6, damping_s_m: 0.0, friction: 0.5, creep_m_s: 1e-3 };
    let touch = |velocity| Touch { depth: 1e-3, normal: Vector3::y(), velocity };
    let at = contact.force(&touch(Vector3::new(0.2, 0.0, 0.0)), 1e-4);
    assert!((at.force - Vector3::new(-0.05, 0.1, 0.0)).norm() < 1e-12, "{}", at.force);
    // Slower than the creep, in proportion.
    let at = contact.force(&touch(Vector3::new(0.0, 0.0, 1e-4)), 1e-4);
    assert!((at.force - Vector3::new(0.0, 0.1, -0.005)).norm() < 1e-12);
    // Damping resists going in, and pulls at nothing that leaves.
    let damped = Contact { damping_s_m: 10.0, ..contact };
    let inwards = damped.force(&touch(Vector3::new(0.0, -0.1, 0.0)), 1e-4).force.y;
    let outwards = damped.force(&touch(Vector3::new(0.0, 0.5, 0.0)), 1e-4).force.y;
    assert!((inwards - 0.2).abs() < 1e-12 && outwards == 0.0);
}

#[test]
fn obstacles_without_a_shape_are_refused() {
    let sphere = |radius_m| Obstacle::Sphere { center_m: [0.0; 3], radius_m }.check();
    assert_eq!(sphere(1.0), Ok(()));
    assert_eq!(sphere(0.0), Err(ObstacleError::Radius(0.0)));
    assert!(sphere(f64::NAN).is_err());
    let plane = |normal| Obstacle::Plane { point_m: [0.0; 3], normal }.check();
    assert_eq!(plane([0.0; 3]), Err(ObstacleError::NoNormal));
    assert_eq!(plane([0.0, f64::INFINITY, 0.0]), Err(ObstacleError::NonFinite));
}
