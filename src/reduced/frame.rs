//! The rigid frame of a body that nothing holds, and the inertial forces that it brings about in the subspace.
//!
//! A point is at x = c + R y with y = X + u(q) from the centre of mass. The basis is orthogonal to rigid
//! motions, so c is the centre of mass whatever q is. Linear and angular momentum are the state: without
//! external forces they are constant by construction, and the angular velocity follows from
//! ω = J(q)⁻¹(RᵀL − h(q, q̇)).
//!
//! With B a 3×3 matrix, UᵀM B (X + Uq) is a sum of nine reduced matrices, one for each entry of B: the fast
//! sandwich transform (Kim and James, ACM Trans. Graph. 30, 2011, §6.3). Inertia, angular momentum and inertial
//! forces all take that form, and nothing of the size of the mesh.

use crate::material::Mat3;
use faer::Mat;
use nalgebra::{UnitQuaternion, Vector3};

/// Where a body is, and how it is turned: x = position + rotation·y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Centre of mass in m.
    pub position_m: Vector3<f64>,
    /// From body to world.
    pub rotation: UnitQuaternion<f64>,
}

/// Motion of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    pub(crate) frame: Frame,
    /// Linear momentum in kg·m/s.
    pub(crate) momentum: Vector3<f64>,
    /// Angular momentum about the centre of mass in kg·m²/s, in the world.
    pub(crate) angular_momentum: Vector3<f64>,
    /// Angular acceleration of the last step, in the body's frame.
    pub(crate) angular_acceleration: Vector3<f64>,
}

/// Reduced inertia of a free body.
#[derive(Debug)]
pub struct FreeBody {
    mass_kg: f64,
    center_m: Vector3<f64>,
    /// Σ m X Xᵀ from the centre of mass.
    rest: Mat3,
    /// Column 3·a + b: Σ m u_j\[a\] X\[b\] (r×9).
    mixed: Mat<f64>,
    /// Number 3·a + b: Σ m u_i\[a\] u_j\[b\] (r×r).
    sandwich: [Mat<f64>; 9],
}

impl FreeBody {
    /// `rest` is Σ m X Xᵀ about the centre of mass `center_m`; column 3·a + b of `mixed` (r×9) is Σ m u_j\[a\] X\[b\];
    /// number 3·a + b of `sandwich` (r×r) is Σ m u_i\[a\] u_j\[b\].
    pub fn new(
        mass_kg: f64,
        center_m: [f64; 3],
        rest: Mat3,
        mixed: Mat<f64>,
        sandwich: [Mat<f64>; 9],
    ) -> FreeBody {
        FreeBody { mass_kg, center_m: center_m.into(), rest, mixed, sandwich }
    }

    /// Mass in kg.
    pub fn mass_kg(&self) -> f64 {
        self.mass_kg
    }
    /// The centre of mass at rest, in m.
    pub fn center_m(&self) -> Vector3<f64> {
        self.center_m
    }

    /// UᵀM B (X + Uq), r numbers.
    pub(crate) fn transformed(&self, b: &Mat3, q: &[f64]) -> Vec<f64> {
        let mut sum: Vec<f64> = vec![0.0; q.len()];
        for k in 0..9 {
            let entry = b[(k / 3, k % 3)];
            if entry != 0.0 {
                for (j, sum) in sum.iter_mut().enumerate() {
                    *sum += entry * self.mixed[(j, k)];
                }
            }
        }
        let moved = self.moved(b, q);
        sum.iter_mut().zip(moved).for_each(|(sum, x)| *sum += x);
        sum
    }

    /// UᵀM B Uq, r numbers.
    pub(crate) fn moved(&self, b: &Mat3, q: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; q.len()];
        for (k, matrix) in self.sandwich.iter().enumerate() {
            let entry = b[(k / 3, k % 3)];
            if entry != 0.0 {
                for (i, q) in q.iter().enumerate() {
                    let column = matrix.col_as_slice(i);
                    sum.iter_mut().zip(column).for_each(|(sum, x)| *sum += entry * q * x);
                }
            }
        }
        sum
    }

    /// xᵀ·sandwich_ab·y for all a, b.
    fn quadratic(&self, x: &[f64], y: &[f64]) -> Mat3 {
        Mat3::from_fn(|a, b| {
            let matrix = &self.sandwich[3 * a + b];
            let column = |j: usize| -> f64 {
                matrix.col_as_slice(j).iter().zip(x).map(|(m, x)| m * x).sum()
            };
            y.iter().enumerate().map(|(j, y)| y * column(j)).sum()
        })
    }

    /// Σ_j mixed_ab[j] x_j for all a, b.
    fn linear(&self, x: &[f64]) -> Mat3 {
        Mat3::from_fn(|a, b| {
            self.mixed.col_as_slice(3 * a + b).iter().zip(x).map(|(m, x)| m * x).sum()
        })
    }

    /// The inertia tensor about the centre of mass, in the body's frame, in kg·m².
    pub fn inertia(&self, q: &[f64]) -> Mat3 {
        let linear = self.linear(q);
        let second = self.rest + linear + linear.transpose() + self.quadratic(q, q);
        Mat3::identity() * second.trace() - second
    }

    /// Angular momentum of the deformation, Σ m y × u̇, in the body's frame.
    pub(crate) fn spin(&self, q: &[f64], velocity: &[f64]) -> Vector3<f64> {
        // Σ m y_a u̇_b.
        let moment = self.linear(velocity).transpose() + self.quadratic(q, velocity);
        Vector3::new(
            moment[(1, 2)] - moment[(2, 1)],
            moment[(2, 0)] - moment[(0, 2)],
            moment[(0, 1)] - moment[(1, 0)],
        )
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        9 * size_of::<f64>() * (self.mixed.nrows() + self.mixed.nrows().pow(2))
    }
}

impl Motion {
    /// At rest where the body was built.
    pub(crate) fn at_rest(body: &FreeBody) -> Motion {
        Motion {
            frame: Frame { position_m: body.center_m, rotation: UnitQuaternion::identity() },
            momentum: Vector3::zeros(),
            angular_momentum: Vector3::zeros(),
            angular_acceleration: Vector3::zeros(),
        }
    }

    /// ω in the body's frame, in 1/s.
    pub(crate) fn angular_velocity(
        &self,
        body: &FreeBody,
        q: &[f64],
        velocity: &[f64],
    ) -> Option<Vector3<f64>> {
        let angular = self.frame.rotation.inverse() * self.angular_momentum;
        let omega = body.inertia(q).try_inverse()? * (angular - body.spin(q, velocity));
        omega.iter().all(|x| x.is_finite()).then_some(omega)
    }

    /// Velocity of the centre of mass in m/s.
    pub(crate) fn velocity(&self, body: &FreeBody) -> Vector3<f64> {
        self.momentum / body.mass_kg
    }

    /// The frame after `dt` at these velocities (ω in the body's frame).
    pub(crate) fn moved(&self, body: &FreeBody, omega: &Vector3<f64>, dt: f64) -> Frame {
        let turn = UnitQuaternion::from_scaled_axis(omega * dt);
        let mut rotation = self.frame.rotation * turn;
        rotation.renormalize();
        Frame { position_m: self.frame.position_m + self.velocity(body) * dt, rotation }
    }
}

/// UᵀM of the acceleration that a point at y has by the frame's rotation alone: ω̇ × y + 2ω × u̇ + ω × (ω × y).
pub(crate) fn inertial_load(
    body: &FreeBody,
    q: &[f64],
    velocity: &[f64],
    omega: &Vector3<f64>,
    angular_acceleration: &Vector3<f64>,
) -> Vec<f64> {
    let turn = omega.cross_matrix();
    let static_part = angular_acceleration.cross_matrix() + turn * turn;
    let mut load = body.transformed(&static_part, q);
    let coriolis = body.moved(&(turn * 2.0), velocity);
    load.iter_mut().zip(coriolis).for_each(|(load, x)| *load += x);
    load
}
