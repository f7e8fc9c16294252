//! Checks of a caller's input that need no computation: sizes against the limits, and numbers.

use crate::config::Limits;
use crate::error::{InputError, StoreError};
use crate::session::{CreateSession, EditRequest};
use crate::simulation::{ContactConfig, GrabConfig, SimulationConfig, VertexForce};
use sutura_core::edit::Edit;
use sutura_core::reduced::Evaluation;

fn at_most(what: &'static str, limit: usize, given: usize) -> Result<(), StoreError> {
    if given <= limit { Ok(()) } else { Err(StoreError::TooLarge { what, limit, given }) }
}

pub(crate) fn name(name: &str, limits: &Limits) -> Result<(), StoreError> {
    at_most("bytes of name", limits.max_name_bytes, name.len())?;
    if name.is_empty() || name.chars().any(char::is_control) {
        return Err(InputError::Name.into());
    }
    Ok(())
}

pub(crate) fn create(request: &CreateSession, limits: &Limits) -> Result<(), StoreError> {
    let CreateSession { mesh, params, .. } = request;
    name(&request.name, limits)?;
    at_most("vertices", limits.max_vertices, mesh.vertices().len())?;
    at_most("tets", limits.max_tets, mesh.tets().len())?;
    at_most("domains", limits.max_domains, mesh.domains().len())?;
    at_most("modes", limits.max_modes, params.n_modes)?;
    at_most("derivative modes", limits.max_modes, params.n_derivative_modes)?;
    at_most("basis columns", limits.max_basis_size, params.basis_size)?;
    at_most("seams", limits.max_seams, params.seams.len())?;
    // More than every vertex cannot be fixed, however often each is named.
    at_most("fixed vertices", limits.max_vertices, params.fixed_vertices.len())?;
    if let Some(cubature) = params.cubature {
        at_most("cubature points", limits.max_cubature_points, cubature.n_points)?;
        at_most("training poses", limits.max_training_poses, cubature.n_training_poses)?;
    }
    Ok(())
}

/// Checks how many candidate pairs a session may name.
pub(crate) fn seams(n_pairs: usize, limits: &Limits) -> Result<(), StoreError> {
    at_most("seams", limits.max_seams, n_pairs)
}

pub(crate) fn edit(request: &EditRequest, limits: &Limits) -> Result<(), StoreError> {
    at_most("edits in one request", limits.max_edits_per_request, request.edits.len())?;
    if request.edits.is_empty() && request.restore.is_none() {
        return Err(InputError::NoEdits.into());
    }
    if !(request.tolerance > 0.0 && request.tolerance < 1.0) {
        return Err(InputError::Tolerance(request.tolerance).into());
    }
    for edit in &request.edits {
        match edit {
            Edit::Stitch { pairs, .. } | Edit::Close { pairs, .. } => {
                at_most("stitches in one edit", limits.max_stitches, pairs.len())?;
            }
            Edit::UnstitchAll | Edit::ScaleStiffness { .. } => {}
            Edit::Fix { vertices } | Edit::Release { vertices } => {
                at_most("vertices in one edit", limits.max_vertices, vertices.len())?;
            }
            Edit::Unstitch { stitch_ids } | Edit::SetStiffness { stitch_ids, .. } => {
                at_most("stitches in one edit", limits.max_stitches, stitch_ids.len())?;
            }
        }
    }
    Ok(())
}

/// Checks how many stitches would be in force after `edits`, with `n_stitches` in force now.
pub(crate) fn n_stitches(
    n_stitches: usize,
    edits: &[Edit],
    limits: &Limits,
) -> Result<(), StoreError> {
    let after = edits.iter().fold(n_stitches, |n, edit| match edit {
        Edit::Stitch { pairs, .. } | Edit::Close { pairs, .. } => n + pairs.len(),
        Edit::Unstitch { stitch_ids } => n.saturating_sub(stitch_ids.len()),
        Edit::UnstitchAll => 0,
        Edit::SetStiffness { .. }
        | Edit::ScaleStiffness { .. }
        | Edit::Fix { .. }
        | Edit::Release { .. } => n,
    });
    at_most("stitches", limits.max_stitches, after)
}

/// Checks poses for a basis of `r` columns.
pub(crate) fn poses(poses: &[Vec<f64>], r: usize, limits: &Limits) -> Result<(), StoreError> {
    at_most("poses in one request", limits.max_evaluations_per_request, poses.len())?;
    for (pose, q) in poses.iter().enumerate() {
        if q.len() != r {
            return Err(InputError::PoseLength { pose, given: q.len(), r }.into());
        }
        if let Some(index) = q.iter().position(|x| !x.is_finite()) {
            return Err(InputError::PoseNotFinite { pose, index }.into());
        }
    }
    Ok(())
}

/// Checks the answer for one pose: finite coordinates can still overflow.
pub(crate) fn evaluation(pose: usize, evaluation: &Evaluation) -> Result<(), StoreError> {
    let Evaluation { energy_j, force, stiffness } = evaluation;
    if std::iter::once(energy_j).chain(force).chain(stiffness).all(|x| x.is_finite()) {
        Ok(())
    } else {
        Err(InputError::PoseOverflows { pose }.into())
    }
}

pub(crate) fn simulation(config: &SimulationConfig, limits: &Limits) -> Result<(), StoreError> {
    let SimulationConfig { params, ref obstacles, contact, publish_hz } = *config;
    let low = limits.min_dt_s;
    if !(low..=1.0).contains(&params.dt_s) {
        return Err(InputError::TimeStep { given: params.dt_s, low }.into());
    }
    params.check()?;
    let high = limits.max_publish_hz;
    if !(publish_hz > 0.0 && publish_hz <= high) {
        return Err(InputError::PublishRate { given: publish_hz, high }.into());
    }
    at_most("obstacles of one simulation", limits.max_obstacles, obstacles.len())?;
    for (obstacle, shape) in obstacles.iter().enumerate() {
        shape.check().map_err(|error| InputError::Obstacle { obstacle, error })?;
    }
    let ContactConfig { stiffness_pa_m, damping_s_m, friction, creep_m_s } = contact;
    for (name, value) in
        [("stiffness_pa_m", stiffness_pa_m.unwrap_or(1.0)), ("creep_m_s", creep_m_s.unwrap_or(1.0))]
    {
        if !(value > 0.0 && value.is_finite()) {
            return Err(InputError::Contact { name, rule: "positive and finite", value }.into());
        }
    }
    for (name, value) in [("damping_s_m", damping_s_m), ("friction", friction)] {
        if !(value >= 0.0 && value.is_finite()) {
            let rule = "finite and not negative";
            return Err(InputError::Contact { name, rule, value }.into());
        }
    }
    Ok(())
}

pub(crate) fn grabs(
    grabs: &[GrabConfig],
    n_released: usize,
    n_vertices: usize,
    limits: &Limits,
) -> Result<(), StoreError> {
    at_most("grabs of one simulation", limits.max_grabs, grabs.len().max(n_released))?;
    for (grab, GrabConfig { vertex, target_m, stiffness_n_m, damping_n_s_m, .. }) in
        grabs.iter().enumerate()
    {
        if *vertex as usize >= n_vertices {
            return Err(InputError::GrabVertex { grab, vertex: *vertex, n_vertices }.into());
        }
        if !target_m.iter().all(|x| x.abs() <= 1e9) {
            return Err(InputError::GrabTarget { grab }.into());
        }
        for (name, value) in [("stiffness_n_m", stiffness_n_m), ("damping_n_s_m", damping_n_s_m)] {
            if !(0.0..=MOST_GRAB_STIFFNESS).contains(value) {
                let high = MOST_GRAB_STIFFNESS;
                return Err(InputError::GrabStrength { grab, name, value: *value, high }.into());
            }
        }
    }
    Ok(())
}

/// In N/m, and as damping in N·s/m.
const MOST_GRAB_STIFFNESS: f64 = 1e9;

pub(crate) fn forces(
    forces: &[VertexForce],
    n_vertices: usize,
    limits: &Limits,
) -> Result<(), StoreError> {
    at_most("forces in one request", limits.max_forces_per_request, forces.len())?;
    for (force, VertexForce { vertex, force_n, duration_s }) in forces.iter().enumerate() {
        if *vertex as usize >= n_vertices {
            return Err(InputError::ForceVertex { force, vertex: *vertex, n_vertices }.into());
        }
        let high = limits.max_force_n;
        if !force_n.iter().all(|f| f.abs() <= high) {
            return Err(InputError::ForceSize { force, high }.into());
        }
        let high = limits.max_force_duration_s;
        if !(*duration_s > 0.0 && *duration_s <= high) {
            return Err(InputError::ForceDuration { force, given: *duration_s, high }.into());
        }
    }
    Ok(())
}
