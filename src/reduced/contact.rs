//! Contact of the body's surface with obstacles, by penalty with friction, evaluated through the basis rows
//! of surface vertices alone.
//!
//! Vertices are kept in clusters, each with a sphere that holds it whatever the deformation: the sphere's
//! centre moves with the mean of the cluster's rows, and its radius grows by |q_k| times the most that a
//! vertex differs from that mean in column k (James and Pai, *BD-Tree*, ACM Trans. Graph. 23, 2004). Only
//! clusters whose sphere touches an obstacle are looked at vertex by vertex.

use crate::interaction::{Placement, PointForce};
use crate::material::Mat3;
use nalgebra::Vector3;

/// Something rigid that the body cannot enter, at rest in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Obstacle {
    /// Everything on the far side of a plane.
    Plane {
        /// A point of the plane, in m.
        point_m: [f64; 3],
        /// Where the body may be; any length but zero.
        normal: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Its centre, in m.
        center_m: [f64; 3],
        /// Its radius, in m.
        radius_m: f64,
    },
    /// All points within a radius of a line segment.
    Capsule {
        /// One end of the segment, in m.
        from_m: [f64; 3],
        /// The other end, in m.
        to_m: [f64; 3],
        /// Its radius, in m.
        radius_m: f64,
    },
}

/// Why an obstacle is none.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ObstacleError {
    /// A coordinate is not finite.
    #[error("coordinates must be finite")]
    NonFinite,
    /// The plane has no direction.
    #[error("normal must not be zero")]
    NoNormal,
    /// The radius is no radius.
    #[error("radius_m must be positive and finite, not {0}")]
    Radius(f64),
}

impl Obstacle {
    /// Refuses what has no shape.
    pub fn check(&self) -> Result<(), ObstacleError> {
        let (points, radius_m): (&[[f64; 3]], f64) = match self {
            Obstacle::Plane { point_m, normal } => (&[*point_m, *normal], 1.0),
            Obstacle::Sphere { center_m, radius_m } => (&[*center_m], *radius_m),
            Obstacle::Capsule { from_m, to_m, radius_m } => (&[*from_m, *to_m], *radius_m),
        };
        if points.iter().flatten().any(|x| !x.is_finite()) {
            return Err(ObstacleError::NonFinite);
        }
        if !(radius_m > 0.0 && radius_m.is_finite()) {
            return Err(ObstacleError::Radius(radius_m));
        }
        match self {
            Obstacle::Plane { normal, .. } if Vector3::from(*normal).norm() < 1e-150 => {
                Err(ObstacleError::NoNormal)
            }
            _ => Ok(()),
        }
    }

    /// The obstacle in the body's frame.
    pub(crate) fn seen_from(&self, placement: &Placement) -> LocalObstacle {
        match *self {
            Obstacle::Plane { point_m, normal } => {
                let normal = placement.turned(normal).normalize();
                LocalObstacle::Plane { normal, offset: normal.dot(&placement.inside(point_m)) }
            }
            Obstacle::Sphere { center_m, radius_m } => {
                let center = placement.inside(center_m);
                LocalObstacle::Capsule { from: center, axis: Vector3::zeros(), radius: radius_m }
            }
            Obstacle::Capsule { from_m, to_m, radius_m } => {
                let from = placement.inside(from_m);
                let axis = placement.inside(to_m) - from;
                LocalObstacle::Capsule { from, axis, radius: radius_m }
            }
        }
    }
}

/// An [`Obstacle`] in the body's frame; a sphere is a capsule without length.
#[derive(Clone, Copy, Debug)]
pub(crate) enum LocalObstacle {
    Plane { normal: Vector3<f64>, offset: f64 },
    Capsule { from: Vector3<f64>, axis: Vector3<f64>, radius: f64 },
}

impl LocalObstacle {
    /// Signed distance of `y` and the direction in which it grows.
    fn distance(&self, y: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match self {
            LocalObstacle::Plane { normal, offset } => (normal.dot(y) - offset, *normal),
            LocalObstacle::Capsule { from, axis, radius } => {
                let along = axis.norm_squared();
                let t = if along > 0.0 { (y - from).dot(axis) / along } else { 0.0 };
                let away = y - from - axis * t.clamp(0.0, 1.0);
                let length = away.norm();
                // Right in the middle every way out is as good.
                let normal = if length > 0.0 { away / length } else { Vector3::y() };
                (length - radius, normal)
            }
        }
    }
}

/// How obstacles push back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Pressure for each metre of depth, in Pa/m.
    pub stiffness_pa_m: f64,
    /// Damping of the motion into the obstacle: at 1 m/s the pressure grows by this fraction (Hunt and
    /// Crossley 1975: in proportion to the depth, so that no force sets in at once).
    pub damping_s_m: f64,
    /// Coulomb's coefficient of friction.
    pub friction: f64,
    /// Sliding slower than this in m/s meets friction in proportion to its speed: what sticks creeps, and this
    /// is how fast it does at most.
    pub creep_m_s: f64,
}

/// A vertex in an obstacle.
pub(crate) struct Touch {
    /// How deep, in m.
    depth: f64,
    normal: Vector3<f64>,
    /// Velocity relative to the obstacle.
    velocity: Vector3<f64>,
}

impl Contact {
    pub(crate) fn force(&self, touch: &Touch, area_m2: f64) -> PointForce {
        let Touch { depth, normal, velocity } = touch;
        let approach = -normal.dot(velocity);
        // Never holds back what leaves.
        let factor = (1.0 + self.damping_s_m * approach).max(0.0);
        let rate = if factor > 0.0 { self.damping_s_m } else { 0.0 };
        let stiffness_n_m = self.stiffness_pa_m * area_m2 * factor;
        let damping_n_s_m = self.stiffness_pa_m * area_m2 * depth * rate;
        let push = stiffness_n_m * depth;
        let across = Mat3::identity() - normal * normal.transpose();
        let sliding = across * velocity;
        let speed = sliding.norm();
        let direction = sliding / speed.max(self.creep_m_s);
        // The change of the direction; none along itself where the speed is above the creep.
        let turning = match speed > self.creep_m_s {
            true => (across - direction * direction.transpose()) / speed,
            false => across / self.creep_m_s,
        };
        // Both parts grow with the pressure. That the normal turns along a curved obstacle only softens
        // the matrix, and is left out.
        let along = (normal - direction * self.friction) * normal.transpose();
        PointForce {
            force: (normal - direction * self.friction) * push,
            stiffness: along * stiffness_n_m,
            damping: along * damping_n_s_m + turning * (self.friction * push),
        }
    }
}

/// Vertices in a cluster at most.
const CLUSTER_SIZE: usize = 32;

/// The body's surface in the subspace, in single precision.
#[derive(Debug)]
pub struct ContactSurface {
    r: usize,
    /// Rest positions in m.
    rest: Vec<[f64; 3]>,
    area_m2: Vec<f64>,
    /// Three rows of r numbers a vertex.
    rows: Vec<f32>,
    clusters: Vec<Cluster>,
}

#[derive(Debug)]
struct Cluster {
    first: usize,
    count: usize,
    center: Vector3<f64>,
    /// Three mean rows of r numbers.
    mean: Vec<f32>,
    /// The furthest vertex from the centre at rest, in m.
    radius: f64,
    /// The most by which a vertex's rows differ from the mean, column by column.
    deviation: Vec<f32>,
}

/// A vertex of the surface.
#[derive(Clone, Debug)]
pub struct SurfaceVertex {
    /// Where it rests, in m.
    pub rest_m: [f64; 3],
    /// The part of the surface that it stands for, in m².
    pub area_m2: f64,
}

impl ContactSurface {
    /// `rows(vertex)` are the three rows of r numbers of each of `vertices`.
    pub fn new(
        r: usize,
        vertices: &[SurfaceVertex],
        rows: impl Fn(usize) -> Vec<f32>,
    ) -> ContactSurface {
        let mut order: Vec<usize> = (0..vertices.len()).collect();
        sort_by_place(&mut order, vertices);
        let mut surface = ContactSurface {
            r,
            rest: order.iter().map(|&v| vertices[v].rest_m).collect(),
            area_m2: order.iter().map(|&v| vertices[v].area_m2).collect(),
            rows: Vec::with_capacity(3 * r * vertices.len()),
            clusters: Vec::new(),
        };
        for &v in &order {
            surface.rows.extend(rows(v));
        }
        for first in (0..order.len()).step_by(CLUSTER_SIZE) {
            let count = CLUSTER_SIZE.min(order.len() - first);
            surface.clusters.push(surface.cluster(first, count));
        }
        surface
    }

    fn cluster(&self, first: usize, count: usize) -> Cluster {
        let members = first..first + count;
        let share = 1.0 / count as f64;
        let place = |v: usize| Vector3::from(self.rest[v]);
        let center = members.clone().map(place).sum::<Vector3<f64>>() * share;
        let mut mean = vec![0.0f32; 3 * self.r];
        for v in members.clone() {
            mean.iter_mut().zip(self.rows(v)).for_each(|(m, x)| *m += share as f32 * x);
        }
        let mut deviation = vec![0.0f32; self.r];
        for v in members.clone() {
            let rows = self.rows(v);
            for (k, most) in deviation.iter_mut().enumerate() {
                let squared: f32 =
                    (0..3).map(|a| (rows[a * self.r + k] - mean[a * self.r + k]).powi(2)).sum();
                *most = most.max(squared.sqrt());
            }
        }
        let radius = members.map(|v| (place(v) - center).norm()).fold(0.0, f64::max);
        Cluster { first, count, center, mean, radius, deviation }
    }

    /// Number of vertices.
    pub fn n_vertices(&self) -> usize {
        self.rest.len()
    }

    /// Columns of the basis.
    pub fn r(&self) -> usize {
        self.r
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.rows[..])
            + self.rest.len() * 32
            + self.clusters.len() * (4 * 4 * self.r + size_of::<Cluster>())
    }

    pub(crate) fn area_m2(&self, vertex: usize) -> f64 {
        self.area_m2[vertex]
    }

    pub(crate) fn rows(&self, vertex: usize) -> &[f32] {
        &self.rows[3 * self.r * vertex..][..3 * self.r]
    }

    /// Calls `found` for every vertex in each obstacle, with its position in the body's frame.
    pub(crate) fn touch(
        &self,
        obstacles: &[LocalObstacle],
        placement: &Placement,
        q: &[f64],
        velocity: &[f64],
        mut found: impl FnMut(usize, Vector3<f64>, Touch),
    ) {
        if obstacles.is_empty() {
            return;
        }
        // In double precision: with q rounded, forces would be rough by more than Newton's method has to
        // reach.
        let displaced = |rows: &[f32], q: &[f64]| {
            Vector3::from_fn(|axis, _| inner(&rows[axis * self.r..][..self.r], q))
        };
        for cluster in &self.clusters {
            let center = cluster.center - placement.origin + displaced(&cluster.mean, q);
            let spread =
                cluster.deviation.iter().zip(q).map(|(d, q)| f64::from(*d) * q.abs()).sum::<f64>();
            // Rows in single precision may be short by their rounding.
            let radius = cluster.radius + 1.0001 * spread;
            let near = |obstacle: &&LocalObstacle| obstacle.distance(&center).0 <= radius;
            let near: Vec<&LocalObstacle> = obstacles.iter().filter(near).collect();
            if near.is_empty() {
                continue;
            }
            for vertex in cluster.first..cluster.first + cluster.count {
                let rows = self.rows(vertex);
                let y = Vector3::from(self.rest[vertex]) - placement.origin + displaced(rows, q);
                for obstacle in &near {
                    let (distance, normal) = obstacle.distance(&y);
                    if distance < 0.0 {
                        let speed = placement.velocity + placement.omega.cross(&y);
                        let touch = Touch {
                            depth: -distance,
                            normal,
                            velocity: speed + displaced(rows, velocity),
                        };
                        found(vertex, y, touch);
                    }
                }
            }
        }
    }
}

/// Neighbours in space next to each other: halves along the longest axis, again and again.
fn sort_by_place(order: &mut [usize], vertices: &[SurfaceVertex]) {
    if order.len() <= CLUSTER_SIZE {
        return;
    }
    let place = |v: usize| Vector3::from(vertices[v].rest_m);
    let (low, high) = order.iter().fold(
        (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)),
        |(low, high), &v| (low.inf(&place(v)), high.sup(&place(v))),
    );
    let axis = (high - low).imax();
    // Whole clusters on the left, so that none straddles the cut.
    let middle = (order.len() / 2).next_multiple_of(CLUSTER_SIZE).min(order.len() - 1);
    order.select_nth_unstable_by(middle, |&a, &b| {
        vertices[a].rest_m[axis].total_cmp(&vertices[b].rest_m[axis]).then(a.cmp(&b))
    });
    let (left, right) = order.split_at_mut(middle);
    sort_by_place(left, vertices);
    sort_by_place(right, vertices);
}

fn inner(x: &[f32], y: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sum = [0.0; LANES];
    let (x_rest, y_rest) = (x.chunks_exact(LANES).remainder(), y.chunks_exact(LANES).remainder());
    for (x, y) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sum[lane] += f64::from(x[lane]) * y[lane];
        }
    }
    let tail = x_rest.iter().zip(y_rest).map(|(x, y)| f64::from(*x) * y).sum::<f64>();
    sum.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests;
