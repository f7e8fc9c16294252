//! A body whose pairs of vertices have been pulled together ([`closing`](crate::closing)) as a base
//! body of its own.
//!
//! What is neglected: the closed shape counts as free of stress. Its strain energy is reported and
//! dropped, with the stress that would pull the seam open again and stiffen or soften the body
//! around it; the masses are those of the closed shape's volumes; displacements of simulations and
//! deltas count from the new rest shape.

use super::artifacts::Prepared;
use super::params::{self, BuildError};
use crate::assembly::FullModel;
use crate::closing::{self, Closed, Closing, Level};
use crate::control::Control;
use crate::edit::{COINCIDENCE_RATIO, EditError, EditState};
use crate::mesh::TetMesh;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A pair before and after its closing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedPair {
    /// The two vertices.
    pub pair: [u32; 2],
    /// The distance that they had, in m.
    pub gap_before_m: f64,
    /// The distance that the springs left, in m; the two were moved by half of it each, so that now they
    /// coincide.
    pub gap_m: f64,
}

/// What a closing did.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosingReport {
    /// The edit's place in its request.
    pub edit: usize,
    /// Its pairs.
    pub pairs: Vec<ClosedPair>,
    /// The equilibria on the way.
    pub levels: Vec<Level>,
    /// Strain energy of the closed shape in J: what is dropped with its stress.
    pub dropped_energy_j: f64,
    /// The largest displacement of a vertex in m.
    pub largest_displacement_m: f64,
}

impl ClosingReport {
    /// Imbalance of the last equilibrium's forces, relative to those of the springs.
    pub fn residual(&self) -> f64 {
        self.levels.last().map_or(0.0, |level| level.residual)
    }

    pub(super) fn warning(&self) -> String {
        format!(
            "the closed shape is taken as the new rest shape: its stress is dropped, with a strain \
             energy of {:.3e} J, after displacements of up to {:.3e} m",
            self.dropped_energy_j, self.largest_displacement_m
        )
    }
}

/// The mesh of `state` with `pairs`, and the stitches' pairs, in one place each; refused if a gap wider
/// than `allowed_m` is left. `prepared` is the base body of some generation before.
pub(super) fn closed_shape(
    prepared: &Prepared,
    state: &EditState,
    edit: usize,
    pairs: &[[u32; 2]],
    allowed_m: f64,
    control: &dyn Control,
) -> Result<(Arc<TetMesh>, ClosingReport), BuildError> {
    let base = state.base();
    let mesh = base.mesh();
    let fixed: Vec<u32> = base.fixed_vertices().iter().copied().collect();
    let materials = params::scaled_materials(base, &prepared.params)?;
    let tet_stiffness = &prepared.params.tet_stiffness;
    let model = FullModel::heterogeneous(mesh.clone(), &materials, tet_stiffness, &fixed);
    let stitched = state.stitches().iter().map(|stitch| stitch.pair);
    let all: Vec<[u32; 2]> = pairs.iter().copied().chain(stitched).collect();
    let closed_m = allowed_m.min(COINCIDENCE_RATIO * mesh.diagonal());
    let problem = Closing {
        model: &model,
        pairs: &all,
        closed_m,
        eigenvalue_per_s2: prepared.first_elastic_eigenvalue(),
    };
    let closed = closing::close(&problem, control)?;
    check_gaps(&closed, state, edit, pairs, allowed_m)?;

    let u = model.expand(&closed.displacement_m);
    let mut positions: Vec<[f64; 3]> = mesh
        .vertices()
        .iter()
        .zip(u.chunks_exact(3))
        .map(|(x, u)| [x[0] + u[0], x[1] + u[1], x[2] + u[2]])
        .collect();
    join(&mut positions, &all, |vertex| base.fixed_vertices().contains(&vertex));
    let ends = positions.iter().flatten().zip(mesh.vertices().iter().flatten());
    let moved: Vec<f64> = ends.map(|(after, before)| after - before).collect();
    let u = model.restrict(&moved);
    let largest = u.chunks_exact(3).map(|u| u[0].hypot(u[1]).hypot(u[2])).fold(0.0, f64::max);
    let report = ClosingReport {
        edit,
        pairs: pairs
            .iter()
            .zip(&closed.gaps_m)
            .map(|(&pair, &gap_m)| ClosedPair { pair, gap_before_m: base.distance_m(pair), gap_m })
            .collect(),
        levels: closed.levels,
        dropped_energy_j: model.energy(&u),
        largest_displacement_m: largest,
    };
    let mesh = TetMesh::new(positions, mesh.tets().to_vec(), mesh.labels().to_vec())
        .map_err(|error| EditError::ClosedShape { edit, error })?;
    Ok((Arc::new(mesh), report))
}

/// Refuses the widest gap if it is too wide.
fn check_gaps(
    closed: &Closed,
    state: &EditState,
    edit: usize,
    pairs: &[[u32; 2]],
    allowed_m: f64,
) -> Result<(), EditError> {
    let reason = closed.obstacle.map(|obstacle| obstacle.to_string()).unwrap_or_default();
    let widest = closed.gaps_m.iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b));
    match widest {
        Some((at, &gap_m)) if gap_m.is_nan() || gap_m > allowed_m => Err(match pairs.get(at) {
            Some(&[a, b]) => {
                EditError::NotClosed { edit, pair: at, a, b, gap_m, allowed_m, reason }
            }
            None => {
                let id = state.stitches()[at - pairs.len()].id;
                EditError::StitchOpens { edit, id, gap_m, allowed_m, reason }
            }
        }),
        _ => Ok(()),
    }
}

/// Moves the vertices that `pairs` connect to one place: that of a fixed one among them, or their mean.
fn join(positions: &mut [[f64; 3]], pairs: &[[u32; 2]], is_fixed: impl Fn(u32) -> bool) {
    let mut group_of: BTreeMap<u32, usize> = BTreeMap::new();
    let mut groups: Vec<Vec<u32>> = Vec::new();
    for pair in pairs {
        let found = pair.map(|v| {
            *group_of.entry(v).or_insert_with(|| {
                groups.push(vec![v]);
                groups.len() - 1
            })
        });
        let [kept, merged] = [found[0].min(found[1]), found[0].max(found[1])];
        if kept != merged {
            let moved = std::mem::take(&mut groups[merged]);
            moved.iter().for_each(|&v| {
                group_of.insert(v, kept);
            });
            groups[kept].extend(moved);
        }
    }
    for group in groups {
        let place = match group.iter().find(|&&v| is_fixed(v)) {
            Some(&fixed) => positions[fixed as usize],
            None => std::array::from_fn(|axis| {
                let sum: f64 = group.iter().map(|&v| positions[v as usize][axis]).sum();
                sum / group.len() as f64
            }),
        };
        for v in group {
            if !is_fixed(v) {
                positions[v as usize] = place;
            }
        }
    }
}
