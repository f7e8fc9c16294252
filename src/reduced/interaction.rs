//! Forces at single points of the body: pulling springs, and contact with obstacles.

use crate::contact::{Contact, ContactSurface, LocalObstacle, Obstacle};
use crate::frame::{Frame, FreeBody, Motion};
use crate::material::Mat3;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::Arc;

/// A vertex in the subspace: u = Σ rows_i q_i.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexRows {
    /// Where the vertex rests, in m.
    pub rest_m: [f64; 3],
    /// Its displacement in each column of the basis (r entries).
    pub rows: Vec<[f64; 3]>,
}

impl VertexRows {
    pub(crate) fn times(&self, q: &[f64]) -> Vector3<f64> {
        let mut u = Vector3::zeros();
        for (row, q) in self.rows.iter().zip(q) {
            u += Vector3::from(*row) * *q;
        }
        u
    }
}

/// A damped spring from a vertex to a point in the world: a hand, or a surgical tool.
#[derive(Clone, Debug, PartialEq)]
pub struct Grab {
    /// The vertex that is held.
    pub vertex: Arc<VertexRows>,
    /// Where it is pulled to, in m.
    pub target_m: [f64; 3],
    /// Stiffness in N/m.
    pub stiffness_n_m: f64,
    /// Damping in N·s/m.
    pub damping_n_s_m: f64,
}

/// Where the body's frame is and how it moves, for a moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub(crate) frame: Frame,
    /// What rest positions are counted from: the centre of mass of a free body, else the origin.
    pub(crate) origin: Vector3<f64>,
    /// Velocity of the frame's origin and its angular velocity, in the body's frame.
    pub(crate) velocity: Vector3<f64>,
    pub(crate) omega: Vector3<f64>,
}

impl Placement {
    /// Of a body that is held: world and body are the same.
    pub(crate) fn fixed() -> Placement {
        Placement {
            frame: Frame { position_m: Vector3::zeros(), rotation: UnitQuaternion::identity() },
            origin: Vector3::zeros(),
            velocity: Vector3::zeros(),
            omega: Vector3::zeros(),
        }
    }

    /// Of a body that nothing holds, at ω in its frame.
    pub(crate) fn free(body: &FreeBody, motion: &Motion, omega: Vector3<f64>) -> Placement {
        let Motion { frame, .. } = *motion;
        let velocity = frame.rotation.inverse() * motion.velocity(body);
        Placement { frame, origin: body.center_m(), velocity, omega }
    }

    /// The frame moved on by `shift` and turned by `turn` (in its own axes), where its velocities grow with
    /// both at `rate`.
    pub(crate) fn corrected(
        &self,
        shift: Vector3<f64>,
        turn: Vector3<f64>,
        rate: f64,
    ) -> Placement {
        let Frame { position_m, rotation } = self.frame;
        let by = UnitQuaternion::from_scaled_axis(turn);
        Placement {
            frame: Frame { position_m: position_m + rotation * shift, rotation: rotation * by },
            origin: self.origin,
            velocity: by.inverse() * (self.velocity + shift * rate),
            omega: self.omega + turn * rate,
        }
    }

    /// A point of the world in the body's frame.
    pub(crate) fn inside(&self, x: [f64; 3]) -> Vector3<f64> {
        self.frame.rotation.inverse() * (Vector3::from(x) - self.frame.position_m)
    }

    /// A direction or force of the world in the body's frame.
    pub(crate) fn turned(&self, f: [f64; 3]) -> Vector3<f64> {
        self.frame.rotation.inverse() * Vector3::from(f)
    }
}

/// Everything that pulls at points.
#[derive(Clone, Copy)]
pub(crate) struct Interactions<'a> {
    pub(crate) grabs: &'a [Grab],
    /// None without a surface.
    pub(crate) obstacles: &'a [Obstacle],
    pub(crate) contact: Option<(&'a ContactSurface, Contact)>,
    /// How many times contact counts in the derivative (see [`crate::step::Scheme::ends`]).
    pub(crate) contact_weight: f64,
}

/// What acts at one point: the force, and its negative derivatives by position and velocity, in the body's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PointForce {
    pub(crate) force: Vector3<f64>,
    pub(crate) stiffness: Mat3,
    pub(crate) damping: Mat3,
}

/// Force and torque about the frame's origin, in the body's frame.
pub(crate) type Wrench = [Vector3<f64>; 2];

/// What all grabs do, or all obstacles.
#[derive(Clone, Debug)]
pub(crate) struct Effect {
    /// Reduced force (r numbers).
    pub(crate) force: Vec<f64>,
    /// What pulls at the frame.
    pub(crate) total: Wrench,
}

/// The sum of all, and its derivative.
pub(crate) struct Pull {
    pub(crate) grabs: Effect,
    pub(crate) contact: Effect,
    /// Minus the derivative of grabs and (as many times as it counts) contact, by q and by the frame's shift and turn
    /// (r×r or (r + 6)×(r + 6)), if asked for.
    pub(crate) stiffness: Option<Mat<f64>>,
    /// Whether that derivative may be unsymmetric: friction, or damping in a frame that turns.
    pub(crate) is_unsymmetric: bool,
}

/// The derivative that is asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Derivative {
    /// Derivative of velocities by positions, in 1/s.
    pub(crate) rate: f64,
    /// Whether the frame moves, too.
    pub(crate) of_frame: bool,
}

impl Effect {
    /// Of nothing.
    pub(crate) fn none(r: usize) -> Effect {
        Effect { force: vec![0.0; r], total: [Vector3::zeros(); 2] }
    }
}

impl Interactions<'_> {
    /// Grabs alone.
    pub(crate) fn without_contact(self) -> Self {
        Interactions { obstacles: &[], contact: None, ..self }
    }

    pub(crate) fn are_none(&self) -> bool {
        self.grabs.is_empty() && self.obstacles.is_empty()
    }

    /// Forces at `q` and `velocity` of a body at `placement`, and their derivative if asked for.
    pub(crate) fn pull(
        &self,
        placement: &Placement,
        q: &[f64],
        velocity: &[f64],
        derivative: Option<Derivative>,
    ) -> Pull {
        let r = q.len();
        let n = r + if derivative.is_some_and(|derivative| derivative.of_frame) { 6 } else { 0 };
        let mut pull = Pull {
            grabs: Effect::none(r),
            contact: Effect::none(r),
            stiffness: None,
            is_unsymmetric: placement.omega != Vector3::zeros(),
        };
        // Rows of all points one below the other, and stiffness times rows.
        let mut rows: Vec<f64> = Vec::new();
        let mut responses: Vec<f64> = Vec::new();
        let Placement { origin, velocity: frame_velocity, omega, .. } = *placement;
        // What moves on in a frame that turns is faster there.
        let turning = omega.cross_matrix();
        let mut add = |to: &mut Effect,
                       weight: f64,
                       y: Vector3<f64>,
                       row: &dyn Fn(usize, usize) -> f64,
                       at: PointForce| {
            to.total[0] += at.force;
            to.total[1] += y.cross(&at.force);
            for (i, f) in to.force.iter_mut().enumerate() {
                *f += (0..3).map(|axis| row(axis, i) * at.force[axis]).sum::<f64>();
            }
            if let Some(Derivative { rate, .. }) = derivative {
                let k = at.stiffness + at.damping * (Mat3::identity() * rate + turning);
                // A shift moves the point by itself, a turn by θ × y.
                let lever = -y.cross_matrix();
                let row = |axis: usize, i: usize| match i.checked_sub(r) {
                    None => row(axis, i),
                    Some(i) if i < 3 => f64::from(u8::from(i == axis)),
                    Some(i) => lever[(axis, i - 3)],
                };
                for axis in 0..3 {
                    rows.extend((0..n).map(|i| row(axis, i) * weight));
                    let entry = |i| (0..3).map(|b| k[(axis, b)] * row(b, i)).sum::<f64>();
                    responses.extend((0..n).map(entry));
                }
            }
        };
        for grab in self.grabs {
            let target = placement.inside(grab.target_m);
            let rest = Vector3::from(grab.vertex.rest_m) - origin;
            let y = rest + grab.vertex.times(q);
            let speed = frame_velocity + omega.cross(&y) + grab.vertex.times(velocity);
            let at = PointForce {
                force: (target - y) * grab.stiffness_n_m - speed * grab.damping_n_s_m,
                stiffness: Mat3::identity() * grab.stiffness_n_m,
                damping: Mat3::identity() * grab.damping_n_s_m,
            };
            add(&mut pull.grabs, 1.0, y, &|axis, i| grab.vertex.rows[i][axis], at);
        }
        if let Some((surface, contact)) = &self.contact {
            let obstacles: Vec<LocalObstacle> =
                self.obstacles.iter().map(|obstacle| obstacle.seen_from(placement)).collect();
            surface.touch(&obstacles, placement, q, velocity, |vertex, y, touch| {
                let at = contact.force(&touch, surface.area_m2(vertex));
                let of_vertex = surface.rows(vertex);
                let row = |axis: usize, i: usize| f64::from(of_vertex[axis * r + i]);
                add(&mut pull.contact, self.contact_weight, y, &row, at);
                pull.is_unsymmetric |= contact.friction > 0.0;
            });
        }
        if derivative.is_some() {
            let m = rows.len() / n.max(1);
            let rows = faer::MatRef::from_row_major_slice(&rows, m, n);
            let responses = faer::MatRef::from_row_major_slice(&responses, m, n);
            let mut stiffness = Mat::zeros(n, n);
            matmul(stiffness.as_mut(), Accum::Replace, rows.transpose(), responses, 1.0, Par::Seq);
            pull.stiffness = Some(stiffness);
        }
        pull
    }
}
