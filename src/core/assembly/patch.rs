//! A tet with its neighbours: what the displacement gradient at a smoothed cubature point is made of.
//!
//! Displacements are continuous across a face, so the gradients of the two tets differ by a dyad, D' − D = j ⊗ n, with n
//! the face's normal and j = (D' − D)·n the jump. A smoothed point has the gradient D + Σ j_f ⊗ s_f over the faces of
//! its tet, with four vectors s_f of its own: s_f = n_f/2 takes the mean of both tets, as smoothed finite elements do
//! (Liu, Dai and Nguyen 2007), none leaves the tet's. It is exact for every affine displacement whatever they are, and
//! the energy density there is that of the material, so a rule of such points has an energy as one of tets has.

use super::{FullModel, NOT_FREE};
use faer::{Mat, MatRef};
use nalgebra::Vector3;

/// What a smoothed point takes of the jump across each face of its tet, the face opposite to corner f being the f-th
/// (dimensionless).
pub type Smoothing = [[f64; 3]; 4];

/// Vertices of a patch: the corners of the tet, then that of each neighbour which is not the tet's.
const VERTICES: usize = 8;

/// A tet and its neighbours.
pub(crate) struct Patch {
    /// Degrees of freedom at its vertices, zero where a vertex cannot move or a face has no neighbour.
    pub(crate) dofs: [Option<usize>; 3 * VERTICES],
    /// Whether there is a tet across each face.
    pub(crate) has_neighbour: [bool; 4],
    /// The jump across each face: what each vertex's displacement adds to it, in 1/m.
    jumps: [[f64; VERTICES]; 4],
    /// The corners, from their centroid, in m.
    corners_m: [Vector3<f64>; 4],
}

impl Patch {
    pub(crate) fn new(model: &FullModel, tet: usize) -> Patch {
        let vertices = model.mesh.tets()[tet];
        let gradients = model.gradients[tet].map(Vector3::from);
        let place = |v: u32| Vector3::from(model.mesh.vertices()[v as usize]);
        let centroid = vertices.iter().map(|&v| place(v)).sum::<Vector3<f64>>() / 4.0;
        let mut patch = Patch {
            dofs: [None; 3 * VERTICES],
            has_neighbour: [false; 4],
            jumps: [[0.0; VERTICES]; 4],
            corners_m: vertices.map(|v| place(v) - centroid),
        };
        patch.dofs[..12].copy_from_slice(&model.corner_dofs(tet));
        for face in 0..4 {
            let Some(neighbour) = model.neighbour(tet, face) else { continue };
            patch.has_neighbour[face] = true;
            let normal = -gradients[face].normalize();
            let jump = &mut patch.jumps[face];
            for (corner, gradient) in gradients.iter().enumerate() {
                jump[corner] = -gradient.dot(&normal);
            }
            let others = &model.mesh.tets()[neighbour];
            for (corner, &vertex) in others.iter().enumerate() {
                let across = Vector3::from(model.gradients[neighbour][corner]).dot(&normal);
                match vertices.iter().position(|&v| v == vertex) {
                    Some(shared) => jump[shared] += across,
                    None => {
                        jump[4 + face] = across;
                        let dofs = &model.corner_dofs(neighbour)[3 * corner..][..3];
                        patch.dofs[12 + 3 * face..][..3].copy_from_slice(dofs);
                    }
                }
            }
        }
        patch
    }

    /// The jumps across the faces (12×r, three rows a face) of the fields that have the rows `rows` (24×r) at the
    /// patch's degrees of freedom.
    pub(crate) fn jumps(&self, rows: MatRef<'_, f64>) -> Mat<f64> {
        Mat::from_fn(12, rows.ncols(), |row, column| {
            let of_vertices = self.jumps[row / 3].iter().enumerate();
            of_vertices.map(|(v, share)| share * rows[(3 * v + row % 3, column)]).sum()
        })
    }

    /// The rows at the corners of an affine displacement that has the smoothed gradient, and the fields' mean over the
    /// corners: to whoever takes the gradient of the tet they are fields on it as others are.
    pub(crate) fn corner_rows(&self, rows: MatRef<'_, f64>, smoothing: &Smoothing) -> Mat<f64> {
        let share = |corner: usize, face: usize| {
            Vector3::from(smoothing[face]).dot(&self.corners_m[corner])
        };
        let of_faces: [[f64; 4]; 4] =
            std::array::from_fn(|corner| std::array::from_fn(|face| share(corner, face)));
        let jumps = self.jumps(rows);
        Mat::from_fn(12, rows.ncols(), |row, column| {
            let of_faces = of_faces[row / 3].iter().enumerate();
            let moved: f64 =
                of_faces.map(|(face, share)| share * jumps[(3 * face + row % 3, column)]).sum();
            rows[(row, column)] + moved
        })
    }
}

impl FullModel {
    /// The tet across the face of `tet` opposite to its corner `face`. None across a face of which no vertex may move.
    fn neighbour(&self, tet: usize, face: usize) -> Option<usize> {
        let free =
            (0..4).find(|&corner| corner != face && self.corners[tet][corner] != NOT_FREE)?;
        let vertices = &self.mesh.tets()[tet];
        let on_face = |tet: usize| {
            let mut corners = (0..4).filter(|&corner| corner != face);
            corners.all(|corner| self.mesh.tets()[tet].contains(&vertices[corner]))
        };
        self.incidence
            .of(self.corners[tet][free] as usize)
            .iter()
            .map(|&[element, _]| self.tiles.elements()[element as usize].tet as usize)
            .find(|&other| other != tet && on_face(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;
    use crate::testing::{Bar, Cell, Cut};
    use nalgebra::Matrix3;

    const SMOOTHING: Smoothing =
        [[0.3, -0.1, 0.2], [0.0, 0.4, 0.0], [-0.2, 0.1, 0.1], [0.5, 0.2, -0.3]];

    fn model(fixed: &[u32]) -> FullModel {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [4, 2, 2], cell: Cell::Six, cut: Cut::Whole };
        let material = Material::stvk(5e5, 0.4, 1000.0).unwrap();
        FullModel::new(bar.mesh().mesh, &[material], fixed)
    }

    fn rows(u: &[f64], patch: &Patch) -> Mat<f64> {
        Mat::from_fn(24, 1, |i, _| patch.dofs[i].map_or(0.0, |dof| u[dof]))
    }

    fn gradient(model: &FullModel, tet: usize, rows: &Mat<f64>) -> Matrix3<f64> {
        Matrix3::from_fn(|i, j| {
            (0..4).map(|a| rows[(3 * a + i, 0)] * model.gradients()[tet][a][j]).sum()
        })
    }

    #[test]
    fn a_gradient_and_its_jump_are_the_gradient_across_the_face() {
        let model = model(&[]);
        let u: Vec<f64> = (0..model.n()).map(|i| ((7 * i * i + 3 * i) as f64).sin()).collect();
        let mut n_neighbours = 0;
        for tet in 0..model.corners().len() {
            let patch = Patch::new(&model, tet);
            let rows = rows(&u, &patch);
            let own = model.displacement_gradient(tet, &u);
            for face in (0..4).filter(|&face| patch.has_neighbour[face]) {
                n_neighbours += 1;
                let normal = -Vector3::from(model.gradients()[tet][face]).normalize();
                let mut smoothing = [[0.0; 3]; 4];
                smoothing[face] = normal.into();
                let found = gradient(&model, tet, &patch.corner_rows(rows.as_ref(), &smoothing));
                let across = model.neighbour(tet, face).unwrap();
                let exact = model.displacement_gradient(across, &u);
                let size = exact.norm() + own.norm();
                assert!((found - exact).norm() < 1e-12 * size, "tet {tet}, face {face}");
            }
        }
        // Each inner face is one of two tets.
        let n_surface = model.mesh().surface().len();
        assert_eq!(n_neighbours, 4 * model.corners().len() - n_surface);
    }

    #[test]
    fn an_affine_displacement_keeps_its_gradient_and_every_field_its_mean() {
        let model = model(&[]);
        let slope = Matrix3::from_fn(|i, j| ((3 * i + j) as f64).sin());
        let affine: Vec<f64> = model
            .mesh()
            .vertices()
            .iter()
            .flat_map(|x| <[f64; 3]>::from(slope * Vector3::from(*x)))
            .collect();
        let affine = model.restrict(&affine);
        let other: Vec<f64> = (0..model.n()).map(|i| ((5 * i) as f64).cos()).collect();
        for tet in [0, 17, 60] {
            let patch = Patch::new(&model, tet);
            let smoothed = patch.corner_rows(rows(&affine, &patch).as_ref(), &SMOOTHING);
            assert!((gradient(&model, tet, &smoothed) - slope).norm() < 1e-12 * slope.norm());
            let rows = rows(&other, &patch);
            let smoothed = patch.corner_rows(rows.as_ref(), &SMOOTHING);
            for axis in 0..3 {
                let sum = |m: &Mat<f64>| (0..4).map(|a| m[(3 * a + axis, 0)]).sum::<f64>();
                assert!((sum(&smoothed) - sum(&rows)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn vertices_that_cannot_move_count_as_they_are() {
        let free = model(&[]);
        let n_vertices = free.mesh().vertices().len();
        let fixed: Vec<u32> = (0..n_vertices as u32).step_by(5).collect();
        let held = model(&fixed);
        let mut u: Vec<f64> = (0..3 * n_vertices).map(|i| ((5 * i) as f64).sin()).collect();
        fixed.iter().for_each(|&v| u[3 * v as usize..][..3].fill(0.0));
        for tet in 0..free.corners().len() {
            let [a, b] = [&free, &held].map(|model| {
                let u = &model.restrict(&u);
                let patch = Patch::new(model, tet);
                gradient(model, tet, &patch.corner_rows(rows(u, &patch).as_ref(), &SMOOTHING))
            });
            assert!((a - b).norm() < 1e-12 * a.norm().max(1.0), "tet {tet}");
        }
    }
}
