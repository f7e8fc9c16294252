//! Bodies of sessions that earlier processes left, or that have left memory: read, or made again from what is kept of
//! them.

use crate::archive::generation::GenerationRecord;
use crate::archive::{Contents, Found, Journal};
use crate::chores::Chore;
use crate::control::TaskControl;
use crate::error::StoreError;
use crate::live::LiveSession;
use crate::pool::{CancelFlag, catching};
use crate::prepared::PreparedBodies;
use crate::session::{Generation, SessionId};
use crate::store::Shared;
use crate::tasks::DEFAULT_TOLERANCE;
use std::sync::{Arc, PoisonError};
use sutura_core::build::{BuildError, Recipe};
use sutura_core::control::Control;
use sutura_core::edit::EditState;

impl Shared {
    /// A name for another session.
    pub(crate) fn new_id(&self) -> SessionId {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let id = SessionId::behind(*newest);
        *newest = Some(id);
        id
    }

    /// Takes in the sessions of earlier processes and begins to restore them, simulated ones first, then the
    /// last changed.
    pub(crate) fn adopt(self: &Arc<Self>, found: Vec<Found>) {
        let mut order = Vec::new();
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        for found in found {
            let modified = found.modified;
            let session = Arc::new(LiveSession::found(found, self.surroundings.clone()));
            sessions.insert(session.id, session.clone());
            order.push((session.has_simulation_config(), modified, session));
        }
        let newest = sessions.keys().next_back().copied();
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = newest;
        drop(sessions);
        if order.is_empty() {
            return;
        }
        tracing::info!(n_sessions = order.len(), "sessions found");
        order.sort_unstable_by_key(|(was_simulated, modified, session)| {
            std::cmp::Reverse((*was_simulated, *modified, session.id))
        });
        for (_, _, session) in order {
            self.later(&session, Chore::Restoration, |store, session, cancel| {
                // One that leaves memory for the next one gains nothing.
                if store.is_within_budget() {
                    // What went wrong is in the log, and whoever asks for the session hears it.
                    let _ = store.restore(session, cancel);
                    store.follow_up(session);
                }
            });
        }
    }

    /// Brings the body of `session` back, if it is not in memory; for the build pool, in its lane.
    pub(crate) fn restore(
        self: &Arc<Self>,
        session: &Arc<LiveSession>,
        cancel: &CancelFlag,
    ) -> Result<(), StoreError> {
        let Some(journal) = session.journal.as_ref() else { return Ok(()) };
        if !session.begin_restore() {
            return Ok(());
        }
        let _span = tracing::info_span!("restore", session = %session.id).entered();
        let work = &self.config.work;
        let admits = |n_bytes: usize| self.make_room(n_bytes, session.id);
        let control =
            TaskControl::reporting(cancel, session, work.progress_interval).within(&admits);
        let n_kept = work.n_kept_generations.max(1);
        let restored =
            catching("restoring", || generations(journal, n_kept, &self.prepared, &control));
        match restored {
            Ok(generations) => {
                tracing::info!(
                    n_generations = generations.len(),
                    seconds = control.now().as_secs_f64(),
                    "session restored"
                );
                session.restored(Ok(generations));
                self.make_room(0, session.id);
                self.resume_simulation(session);
                Ok(())
            }
            Err(error) if is_passing(&error) => {
                tracing::warn!(%error, "session not restored");
                session.restored(Err(None));
                Err(error)
            }
            Err(error) => {
                tracing::error!(%error, "the session cannot be restored");
                session.restored(Err(Some(error)));
                Ok(())
            }
        }
    }

    /// Simulates the session as the earlier process did, from rest.
    fn resume_simulation(self: &Arc<Self>, session: &Arc<LiveSession>) {
        let Some(config) = session.take_simulation_config() else { return };
        match self.simulate(session, &config) {
            Ok(handle) => {
                if !config.obstacles.is_empty() {
                    handle.update_surface();
                }
                tracing::info!("simulation started again, from rest");
            }
            Err(error) => tracing::warn!(%error, "simulation not started again"),
        }
    }
}

/// Whether another try may do better.
fn is_passing(error: &StoreError) -> bool {
    matches!(
        error,
        StoreError::Cancelled
            | StoreError::Taken(_)
            | StoreError::Storage(_)
            | StoreError::Build(BuildError::OverBudget { .. })
    )
}

/// The generations that the session keeps.
fn generations(
    journal: &Journal,
    n_kept: usize,
    prepared: &PreparedBodies,
    control: &dyn Control,
) -> Result<Vec<Arc<Generation>>, StoreError> {
    let Contents { session, generations: mut records, .. } = journal.read()?;
    let unreadable = |error: crate::archive::record::Unreadable| StoreError::Damaged {
        name: format!("the journal of session {}", journal.id()),
        why: error.to_string(),
    };
    let params = session.params.params().map_err(unreadable)?;
    records.drain(..records.len().saturating_sub(n_kept));
    let current = records.last().map_or(0, |record| record.number);
    let mut made: Vec<Arc<Generation>> = Vec::new();
    let body = |recipe: &Recipe, made: &[Arc<Generation>]| {
        let own: Vec<_> = made.iter().map(|generation| generation.artifacts.clone()).collect();
        prepared.body(&params, recipe, &own, control)
    };
    let is_first_kept = current < n_kept as u64 && records.first().is_none_or(|r| r.number > 0);
    if is_first_kept {
        let mesh = journal.mesh(&session.mesh)?;
        let recipe = Recipe::of_build(EditState::new(mesh, &params.fixed_vertices));
        let begun = control.now();
        let artifacts = body(&recipe, &made)?;
        made.push(Arc::new(Generation {
            number: 0,
            artifacts,
            made_by: None,
            tolerance: DEFAULT_TOLERANCE,
            improves: None,
            stitch_ids: Vec::new(),
            computed_in: control.now().saturating_sub(begun),
        }));
    }
    for record in records {
        let number = record.number;
        let body_of = |record: &GenerationRecord| {
            let mesh = journal.mesh(&record.recipe.mesh)?;
            body(&record.recipe.recipe(mesh).map_err(unreadable)?, &made)
        };
        match body_of(&record) {
            Ok(artifacts) => made.push(Arc::new(record.generation(artifacts))),
            Err(error) if is_passing(&error) => return Err(error),
            Err(error) if number == current => return Err(error),
            Err(error) => tracing::error!(number, %error, "an earlier generation is lost"),
        }
    }
    Ok(made)
}

#[cfg(test)]
pub(crate) mod tests;
