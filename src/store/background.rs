//! Work that nobody waits for: seams, what a deadline left undone, and new base bodies.
//!
//! It comes after edits and builds, one task at a time. Losing some of it loses time, nothing else.

use crate::chores::Chore;
use crate::control::TaskControl;
use crate::error::StoreError;
use crate::live::{LiveSession, Rebasing};
use crate::pool::catching;
use crate::session::{Generation, GenerationRef};
use crate::store::Shared;
use crate::tasks::keep;
use std::sync::Arc;
use std::time::Duration;
use sutura_core::build::{
    Artifacts, BaseBody, Method, RebuildParams, prepare_base, prepare_seams, rebase, rebuild,
};
use sutura_core::control::Control;

impl Shared {
    /// What the current generation of `session` leaves to be done, queued.
    pub(crate) fn follow_up(self: &Arc<Self>, session: &Arc<LiveSession>) {
        if self.hand_over_if_taken(session) {
            return;
        }
        self.make_room(0, session.id);
        self.prepare_seams_later(session);
        self.improve_later(session);
        self.rebase_later(session);
        self.compact_later(session);
    }

    /// Shortens the journal of `session` if it has grown long.
    fn compact_later(self: &Arc<Self>, session: &Arc<LiveSession>) {
        let n_kept = self.config.work.n_kept_generations.max(1);
        if !session.journal.as_ref().is_some_and(|journal| journal.is_long(n_kept)) {
            return;
        }
        self.later(session, Chore::Compaction, move |_, session, _| {
            let Some(journal) = session.journal.as_ref() else { return };
            if let Err(error) = catching("shortening a journal", || journal.compact(n_kept)) {
                tracing::warn!(%error, "the journal stays long");
            }
        });
    }

    /// The pairs that the session names and those that are stitched, as far as the base body has not got them
    /// and may take them.
    fn unprepared(&self, session: &LiveSession, body: &Artifacts) -> Vec<[u32; 2]> {
        let stitched = body.stitches().iter().map(|stitch| stitch.pair);
        let named = session.seams().into_iter().chain(body.params().seams.iter().copied());
        let mut missing = body.unprepared(named.chain(stitched));
        let limits = &self.config.limits;
        let most = limits.max_seams.min(limits.max_seam_bytes / body.prepared_pair_bytes().max(1));
        missing.truncate(most.saturating_sub(body.n_prepared_pairs()));
        missing
    }

    /// Prepares the pairs that are [`Shared::unprepared`].
    pub(crate) fn prepare_seams_later(self: &Arc<Self>, session: &Arc<LiveSession>) {
        let Ok(generation) = session.generation(GenerationRef::Current) else { return };
        if self.unprepared(session, &generation.artifacts).is_empty() {
            return;
        }
        // Not in the session's lane: edits go on meanwhile.
        self.later(session, Chore::Seams, |store, session, cancel| {
            let Ok(generation) = session.generation(GenerationRef::Current) else { return };
            let body = &generation.artifacts;
            let missing = store.unprepared(session, body);
            if missing.is_empty() {
                return;
            }
            let control = TaskControl::silent(cancel);
            let done = catching("preparing seams", || {
                prepare_seams(body, &missing, &control).map_err(StoreError::from)
            });
            match done {
                Ok(()) => tracing::info!(n_pairs = body.n_prepared_pairs(), "seams prepared"),
                Err(error) => tracing::info!(%error, "seams not prepared"),
            }
        });
    }

    /// Finishes the current generation of `session` if a deadline left it unfinished.
    fn improve_later(self: &Arc<Self>, session: &Arc<LiveSession>) {
        let unfinished = |session: &LiveSession| {
            let generation = session.generation(GenerationRef::Current).ok()?;
            generation.artifacts.certificate().is_unfinished.then_some(generation)
        };
        if unfinished(session).is_none() {
            return;
        }
        let ticket = self.later(session, Chore::Improvement, move |store, session, cancel| {
            let Some(generation) = unfinished(session) else { return };
            let control = TaskControl::silent(cancel);
            let params = RebuildParams {
                derivatives: generation.artifacts.derivatives(),
                ..RebuildParams::new(Method::Flexibility, generation.tolerance)
            };
            let improved = catching("an improvement", || {
                let made = rebuild(&generation.artifacts, &[], &params, &control);
                Ok(made.map_err(StoreError::from)?.0)
            });
            match improved {
                Ok(artifacts) => store.publish(session, &generation, artifacts, control.now()),
                Err(error) => tracing::info!(%error, "generation not improved"),
            }
        });
        if let Some(ticket) = ticket {
            session.set_improvement(ticket.cancel_on_drop());
        }
    }

    /// Whether a base body that holds the stitches of `body` would serve further edits better than the one
    /// that it is an update of.
    fn is_far_from_base(&self, body: &Artifacts) -> bool {
        let n_open = body.n_open_stitches();
        // Beyond, not all of them could be prepared.
        let most_prepared = self.config.limits.max_seam_bytes / body.prepared_pair_bytes().max(1);
        let most = self.config.work.max_open_stitches.min(most_prepared);
        n_open > most || (n_open > 0 && !body.modes_are_met())
    }

    /// The current generation of `session`, if a base body that holds its stitches is to be prepared.
    fn to_rebase(&self, session: &LiveSession) -> Option<Arc<Generation>> {
        let generation = session.generation(GenerationRef::Current).ok()?;
        let body = &generation.artifacts;
        // Who asked for another method has it.
        let is_update = generation.made_by == Some(Method::Flexibility);
        let is_finished = !body.certificate().is_unfinished;
        (is_update && is_finished && self.is_far_from_base(body)).then_some(generation)
    }

    /// Prepares a base body that holds the stitches of `session` where the present one serves no longer.
    fn rebase_later(self: &Arc<Self>, session: &Arc<LiveSession>) {
        if self.to_rebase(session).is_none() {
            return;
        }
        let Some(rebasing) = session.begin_rebasing() else { return };
        // Not in the session's lane: edits go on meanwhile.
        self.later(session, Chore::BaseBody, move |store, session, cancel| {
            let Some(generation) = store.to_rebase(session) else { return };
            let admits = |n_bytes: usize| store.make_room(n_bytes, session.id);
            let control = TaskControl::silent(cancel).within(&admits);
            let prepared = catching("preparing a base body", || {
                prepare_base(&generation.artifacts, &control).map_err(StoreError::from)
            });
            match prepared {
                Ok(base) => store.move_to_base(session, base, rebasing),
                Err(error) => tracing::info!(%error, "base body not prepared"),
            }
        });
    }

    /// Makes what is current then an update of `base`.
    fn move_to_base(
        self: &Arc<Self>,
        session: &Arc<LiveSession>,
        base: BaseBody,
        rebasing: Rebasing,
    ) {
        self.later(session, Chore::Rebasing, move |store, session, cancel| {
            let Ok(generation) = session.generation(GenerationRef::Current) else { return };
            let control = TaskControl::silent(cancel);
            let made = catching("rebasing", || {
                rebase(&generation.artifacts, &base, &control).map_err(StoreError::from)
            });
            // From here on another one may be prepared, as after edits that this one does not serve.
            drop(rebasing);
            match made {
                Ok(Some(artifacts)) => {
                    store.publish(session, &generation, artifacts, control.now())
                }
                Ok(None) => store.follow_up(session),
                Err(error) => tracing::info!(%error, "generation not rebased"),
            }
        });
    }

    /// Makes `artifacts`, the same body as `generation`, the current generation of `session`.
    fn publish(
        self: &Arc<Self>,
        session: &Arc<LiveSession>,
        generation: &Generation,
        artifacts: Artifacts,
        computed_in: Duration,
    ) {
        let next = Generation {
            number: generation.number + 1,
            artifacts: Arc::new(artifacts),
            made_by: generation.made_by,
            tolerance: generation.tolerance,
            improves: Some(generation.improves.unwrap_or(generation.number)),
            stitch_ids: Vec::new(),
            computed_in,
        };
        if let Err(error) = keep(session, &next) {
            tracing::warn!(%error, "the improved generation could not be kept");
            return;
        }
        tracing::info!(generation = next.number, "generation improved");
        session.publish_and_follow(Arc::new(next), || ());
        self.follow_up(session);
    }
}
