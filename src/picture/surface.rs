//! The boundary of a tetrahedral mesh: the faces that belong to one tet only.

use nalgebra::Vector3;
use std::collections::HashMap;

/// Corners of faces that meet at a sharper angle than this are shaded apart.
const CREASE_COSINE: f64 = 0.7;

/// Boundary triangles, oriented outwards.
pub(crate) struct Surface {
    triangles: Vec<[u32; 3]>,
    /// Triangles at each vertex: those of vertex v are `around[starts[v]..starts[v + 1]]`.
    starts: Vec<u32>,
    around: Vec<u32>,
}

impl Surface {
    pub(crate) fn of(n_vertices: usize, tets: &[[u32; 4]]) -> Surface {
        let mut faces: HashMap<[u32; 3], Option<[u32; 3]>> = HashMap::new();
        for &[a, b, c, d] in tets {
            for face in [[a, c, b], [a, b, d], [a, d, c], [b, c, d]] {
                let mut key = face;
                key.sort_unstable();
                // A second tet on the other side makes the face an inner one.
                faces.entry(key).and_modify(|outer| *outer = None).or_insert(Some(face));
            }
        }
        let mut triangles: Vec<[u32; 3]> = faces.into_values().flatten().collect();
        triangles.sort_unstable();
        let mut starts = vec![0; n_vertices + 1];
        for &vertex in triangles.iter().flatten() {
            starts[vertex as usize + 1] += 1;
        }
        for v in 0..n_vertices {
            starts[v + 1] += starts[v];
        }
        let mut next = starts.clone();
        let mut around = vec![0; 3 * triangles.len()];
        for (triangle, corners) in (0..).zip(&triangles) {
            for &vertex in corners {
                around[next[vertex as usize] as usize] = triangle;
                next[vertex as usize] += 1;
            }
        }
        Surface { triangles, starts, around }
    }

    pub(crate) fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Unit normals at the three corners of every triangle: averages over the faces around the
    /// corner that do not meet this one at a crease.
    pub(crate) fn corner_normals(&self, positions: &[Vector3<f64>]) -> Vec<[Vector3<f64>; 3]> {
        let face_normals: Vec<Vector3<f64>> = self
            .triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.map(|v| positions[v as usize]);
                (b - a).cross(&(c - a))
            })
            .collect();
        let unit = |v: Vector3<f64>| v.try_normalize(0.0).unwrap_or(Vector3::z());
        let corner = |triangle: usize, vertex: u32| {
            let own = unit(face_normals[triangle]);
            let range =
                self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
            let near = self.around[range].iter().map(|&other| face_normals[other as usize]);
            unit(near.filter(|normal| unit(*normal).dot(&own) > CREASE_COSINE).sum())
        };
        let corners = self.triangles.iter().enumerate();
        corners.map(|(i, triangle)| triangle.map(|vertex| corner(i, vertex))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shared_face_of_two_tets_is_inside() {
        let surface = Surface::of(5, &[[0, 1, 2, 3], [0, 2, 1, 4]]);
        assert_eq!(surface.triangles().len(), 6);
        assert!(surface.triangles().iter().all(|t| t.contains(&3) || t.contains(&4)));
    }

    #[test]
    fn triangles_face_outwards() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let positions = positions.map(Vector3::from);
        let surface = Surface::of(4, &[[0, 1, 2, 3]]);
        let centre = positions.iter().sum::<Vector3<f64>>() / 4.0;
        for (triangle, normals) in
            surface.triangles().iter().zip(surface.corner_normals(&positions))
        {
            let outwards = positions[triangle[0] as usize] - centre;
            assert!(normals.iter().all(|normal| normal.dot(&outwards) > 0.0));
        }
    }
}
