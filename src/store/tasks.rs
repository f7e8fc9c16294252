//! What the build pool runs: a session's first build, and its edits.

use crate::check;
use crate::config::StoreConfig;
use crate::control::TaskControl;
use crate::error::StoreError;
use crate::live::LiveSession;
use crate::pool::{CancelFlag, catching};
use crate::prepared::PreparedBodies;
use crate::session::{EditRequest, Generation, GenerationRef};
use std::sync::Arc;
use std::time::Duration;
use sutura_core::build::{BuildParams, RebuildParams, Recipe, rebuild};
use sutura_core::control::Control;
use sutura_core::edit::EditState;
use sutura_core::mesh::TetMesh;
use tokio::sync::oneshot;

/// Tolerance that a build is finished to, if a later rebuild asks: its modes are far below.
pub(crate) const DEFAULT_TOLERANCE: f64 = 1e-4;

/// Builds the first generation of `session`, or takes an equal body that exists already, in memory or kept.
pub(crate) fn run_build(
    session: &LiveSession,
    mesh: Arc<TetMesh>,
    params: &BuildParams,
    prepared: &PreparedBodies,
    interval: Duration,
    cancel: &CancelFlag,
    admits: &(dyn Fn(usize) -> bool + Sync),
) {
    let _span = tracing::info_span!("build", session = %session.id).entered();
    let control = TaskControl::reporting(cancel, session, interval).within(admits);
    let recipe = Recipe::of_build(EditState::new(mesh, &params.fixed_vertices));
    let body = catching("the build", || prepared.body(params, &recipe, &[], &control));
    let computed_in = control.now();
    match &body {
        Ok(body) => tracing::info!(
            n_free_dofs = body.n_free_dofs(),
            n_modes = body.n_modes(),
            basis_size = body.basis_size(),
            seconds = computed_in.as_secs_f64(),
            "body ready"
        ),
        Err(error) => tracing::warn!(%error, "build ended without a body"),
    }
    session.settle(body.map(|artifacts| {
        Arc::new(Generation {
            number: 0,
            artifacts,
            made_by: None,
            tolerance: DEFAULT_TOLERANCE,
            improves: None,
            stitch_ids: Vec::new(),
            computed_in,
        })
    }));
}

/// Writes down what makes `next` again: before anybody hears of it.
pub(crate) fn keep(session: &LiveSession, next: &Generation) -> Result<(), StoreError> {
    session.journal.as_ref().map_or(Ok(()), |journal| journal.add_generation(next))
}

/// Makes the next generation of `session`; `bring_back` restores its body if it is not in memory. Answers as soon as it is current; then the simulation,
/// if there is one, is told to follow.
pub(crate) fn run_edit(
    session: &LiveSession,
    request: &EditRequest,
    config: &StoreConfig,
    cancel: &CancelFlag,
    reply: oneshot::Sender<Result<Arc<Generation>, StoreError>>,
    bring_back: impl FnOnce() -> Result<(), StoreError>,
    admits: &(dyn Fn(usize) -> bool + Sync),
) {
    let begin = |session: &LiveSession| {
        bring_back()?;
        session.begin_rebuild(request.base_generation)
    };
    let _span = tracing::info_span!("edit", session = %session.id).entered();
    let previous = match begin(session) {
        Ok(previous) => previous,
        Err(error) => {
            // The caller may have gone; then nobody needs the answer, here and below.
            let _ = reply.send(Err(error));
            return;
        }
    };
    let interval = config.work.progress_interval;
    let control = TaskControl::reporting(cancel, session, interval).within(admits);
    let made = catching("the edit", || {
        let next = next_generation(session, &previous, request, config, &control)?;
        keep(session, &next)?;
        Ok(next)
    });
    match made {
        Ok(generation) => {
            tracing::info!(
                generation = generation.number,
                method = ?request.method,
                seconds = generation.computed_in.as_secs_f64(),
                "generation ready"
            );
            let answer = generation.clone();
            session.publish_and_follow(generation, || {
                let _ = reply.send(Ok(answer));
            });
        }
        Err(error) => {
            tracing::info!(%error, "edit refused");
            session.abandon_rebuild();
            let _ = reply.send(Err(error));
        }
    }
}

fn next_generation(
    session: &LiveSession,
    previous: &Generation,
    request: &EditRequest,
    config: &StoreConfig,
    control: &dyn Control,
) -> Result<Arc<Generation>, StoreError> {
    let number = previous.number + 1;
    let restored = match request.restore {
        Some(number) => Some(session.generation(GenerationRef::Number(number))?),
        None => None,
    };
    if let Some(restored) = restored.as_ref().filter(|_| request.edits.is_empty()) {
        return Ok(Arc::new(Generation {
            number,
            artifacts: restored.artifacts.clone(),
            made_by: restored.made_by,
            tolerance: restored.tolerance,
            improves: None,
            stitch_ids: Vec::new(),
            computed_in: control.now(),
        }));
    }
    let previous = restored.as_deref().unwrap_or(previous);
    check::n_stitches(previous.artifacts.stitches().len(), &request.edits, &config.limits)?;
    let params = RebuildParams {
        method: request.method,
        derivatives: request.derivatives,
        tolerance: request.tolerance,
        deadline: request.deadline,
    };
    let (artifacts, stitch_ids) = rebuild(&previous.artifacts, &request.edits, &params, control)?;
    if control.is_cancelled() {
        return Err(StoreError::Cancelled);
    }
    Ok(Arc::new(Generation {
        number,
        artifacts: Arc::new(artifacts),
        made_by: Some(request.method),
        tolerance: request.tolerance,
        improves: None,
        stitch_ids,
        computed_in: control.now(),
    }))
}
