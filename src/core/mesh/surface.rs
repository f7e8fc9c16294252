//! The surface of a mesh.

use super::TetMesh;

/// Corners of the face opposite each corner of a tet, turned outwards.
const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

impl TetMesh {
    /// Faces that belong to one tet alone, turned outwards, in the order of the tets.
    pub fn surface(&self) -> Vec<[u32; 3]> {
        let mut faces: Vec<([u32; 3], u32)> = Vec::with_capacity(4 * self.tets().len());
        let face = |number: u32| {
            let tet = &self.tets()[number as usize / 4];
            FACES[number as usize % 4].map(|corner| tet[corner])
        };
        for number in 0..4 * self.tets().len() as u32 {
            let mut key = face(number);
            key.sort_unstable();
            faces.push((key, number));
        }
        faces.sort_unstable();
        let mut outer: Vec<u32> = faces
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|same| same.len() == 1)
            .map(|same| same[0].1)
            .collect();
        outer.sort_unstable();
        outer.into_iter().map(face).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::testing::{Bar, Cell, Cut};

    #[test]
    fn the_surface_of_a_bar_is_closed_and_has_its_area_and_volume() {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.04], n_cells: [4, 2, 3], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let surface = bar.mesh.surface();
        assert_eq!(surface.len(), 2 * 2 * (4 * 2 + 4 * 3 + 2 * 3));
        let x = |v: u32| nalgebra::Vector3::from(bar.mesh.vertices()[v as usize]);
        let areas = surface.iter().map(|f| (x(f[1]) - x(f[0])).cross(&(x(f[2]) - x(f[0]))) * 0.5);
        let (sum, area) = areas
            .fold((nalgebra::Vector3::zeros(), 0.0), |(sum, area), a| (sum + a, area + a.norm()));
        assert!(sum.norm() < 1e-15);
        assert!((area - 2.0 * (0.2 * 0.05 + 0.2 * 0.04 + 0.05 * 0.04)).abs() < 1e-15);
        // Outwards: the divergence theorem gives the volume, and not its negative.
        let volume: f64 = surface.iter().map(|f| x(f[0]).dot(&x(f[1]).cross(&x(f[2]))) / 6.0).sum();
        assert!((volume - 0.2 * 0.05 * 0.04).abs() < 1e-15);
    }
}
