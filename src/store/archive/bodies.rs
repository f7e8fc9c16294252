//! Prepared bodies on a storage: `bodies/<SHA-256>`, under the name of what they are a function of
//! ([`super::snapshot`]), shared by the sessions that use them.
//!
//! They save time and nothing else. So they are written best effort, take up a bounded room, of which those used
//! last stay, and give way to what has to be written. On a shared storage there are none: whether another
//! daemon uses one cannot be known.

use super::frame::{Digest, hex};
use super::generation::RecipeRecord;
use super::record::{ParamsRecord, Unreadable};
use super::snapshot::{self, BodyNames};
use super::{Archive, Contents, Journal, unwritable};
use crate::error::StoreError;
use crate::metrics;
use crate::session::{Generation, SessionId};
use crate::storage::{Entry, Storage, StorageError};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use sutura_core::build::{Artifacts, BaseSnapshot, BuildParams, GenerationSnapshot, Recipe};

const BODIES: &str = "bodies";

/// Every body of a storage.
#[derive(Debug)]
pub(super) struct Bodies {
    storage: Arc<dyn Storage>,
    /// Bytes of all of them.
    max_bytes: u64,
    index: Mutex<Index>,
    /// Held while one is written.
    writing: Mutex<()>,
}

#[derive(Debug, Default)]
struct Index {
    there: BTreeMap<Digest, There>,
    /// What each session uses, there or not.
    users: BTreeMap<SessionId, BTreeSet<Digest>>,
    n_uses: u64,
}

#[derive(Clone, Copy, Debug)]
struct There {
    n_bytes: u64,
    /// When it was used last, in uses of any.
    last_use: u64,
}

fn blob(name: &Digest) -> String {
    format!("{BODIES}/{}", hex(name))
}

impl Bodies {
    /// None yet: [`Bodies::find`] looks what is there.
    pub(super) fn new(storage: Arc<dyn Storage>, max_bytes: u64) -> Bodies {
        let max_bytes = if storage.is_shared() { 0 } else { max_bytes };
        Bodies { storage, max_bytes, index: Mutex::default(), writing: Mutex::default() }
    }

    /// Whether any are kept.
    pub(super) fn are_kept(&self) -> bool {
        self.max_bytes > 0
    }

    /// Looks which are there. Those of no session are cleared away if `all_users` are known, and those beyond
    /// the room that there is, the last written ones excepted.
    pub(super) fn find(&self, all_users: bool) -> Result<(), StorageError> {
        if self.storage.is_shared() {
            return Ok(());
        }
        let mut entries = self.storage.list(BODIES)?;
        entries.sort_by(|a, b| (a.modified, &a.name).cmp(&(b.modified, &b.name)));
        let mut index = self.lock();
        let names: BTreeMap<String, Digest> =
            index.users.values().flatten().map(|name| (blob(name), *name)).collect();
        for Entry { name, n_bytes, .. } in entries {
            match names.get(&name) {
                Some(name) => index.insert(*name, n_bytes),
                None if all_users || !self.are_kept() => {
                    tracing::info!(name, "a body of no session is cleared away");
                    self.storage.delete(&name)?;
                }
                None => {}
            }
        }
        let leaving = index.leaving(self.max_bytes, &BTreeSet::new());
        self.remove(index, leaving);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Index> {
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on the session uses these and no others. What nobody uses is cleared away.
    pub(super) fn set_used(&self, id: SessionId, names: BTreeSet<Digest>) {
        let mut index = self.lock();
        let before = match names.is_empty() {
            true => index.users.remove(&id),
            false => index.users.insert(id, names),
        };
        let unused: Vec<Digest> =
            before.into_iter().flatten().filter(|name| !index.is_used(name)).collect();
        self.remove(index, unused);
    }

    /// Removes bodies, by their names, from the index and behind that from the storage.
    fn remove(&self, mut index: MutexGuard<'_, Index>, names: Vec<Digest>) {
        let there: Vec<Digest> =
            names.into_iter().filter(|name| index.there.remove(name).is_some()).collect();
        metrics::kept_bodies(index.n_bytes());
        drop(index);
        for name in there {
            self.delete(&name);
        }
    }

    fn delete(&self, name: &Digest) {
        if let Err(error) = self.storage.delete(&blob(name)) {
            // A later start tries again.
            tracing::warn!(%error, "a body of no session is left behind");
        }
    }

    /// Whether a body is there.
    pub(super) fn has(&self, name: &Digest) -> bool {
        self.lock().there.contains_key(name)
    }

    /// A body's bytes, if it is there.
    pub(super) fn get(&self, name: &Digest) -> Option<Vec<u8>> {
        let mut index = self.lock();
        index.n_uses += 1;
        let now = index.n_uses;
        index.there.get_mut(name)?.last_use = now;
        drop(index);
        match self.storage.get(&blob(name)) {
            Ok(Some(bytes)) => Some(bytes),
            Ok(None) => {
                self.lock().there.remove(name);
                None
            }
            Err(error) => {
                tracing::warn!(%error, "a body cannot be read");
                None
            }
        }
    }

    /// A body that is not what it should be is there no longer.
    pub(super) fn remove_damaged(&self, name: &Digest, why: &dyn std::fmt::Display) {
        tracing::warn!(name = blob(name), %why, "a kept body is damaged and made again");
        metrics::body("damaged");
        self.remove(self.lock(), vec![*name]);
    }

    /// Keeps a body of the session's. Those used longest ago make room, the session's own excepted. Tells whether
    /// it is there.
    pub(super) fn put(
        &self,
        id: SessionId,
        name: Digest,
        bytes: &[u8],
    ) -> Result<bool, StorageError> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let index = self.lock();
        let Some(own) = index.users.get(&id).filter(|own| own.contains(&name)) else {
            return Ok(false);
        };
        if index.there.contains_key(&name) {
            return Ok(true);
        }
        let n_bytes = bytes.len() as u64;
        let Some(room) = self.max_bytes.checked_sub(n_bytes) else { return Ok(false) };
        let leaving = index.leaving(room, own);
        let freed: u64 = leaving.iter().map(|name| index.there[name].n_bytes).sum();
        if index.n_bytes() - freed > room {
            return Ok(false);
        }
        self.remove(index, leaving);
        self.storage.put(&blob(&name), bytes)?;
        let mut index = self.lock();
        if !index.is_used(&name) {
            // The session has gone meanwhile.
            drop(index);
            self.delete(&name);
            return Ok(false);
        }
        index.insert(name, n_bytes);
        metrics::kept_bodies(index.n_bytes());
        metrics::body("written");
        Ok(true)
    }

    /// The one used longest ago makes room for something that has to be written. Tells whether there was one.
    pub(super) fn give_way(&self) -> bool {
        let index = self.lock();
        let oldest = index.there.iter().min_by_key(|(_, there)| there.last_use);
        let Some(oldest) = oldest.map(|(name, _)| *name) else { return false };
        tracing::warn!(name = blob(&oldest), "the disk is full: a kept body makes room");
        self.remove(index, vec![oldest]);
        true
    }
}

impl Index {
    fn n_bytes(&self) -> u64 {
        self.there.values().map(|there| there.n_bytes).sum()
    }

    fn is_used(&self, name: &Digest) -> bool {
        self.users.values().any(|names| names.contains(name))
    }

    fn insert(&mut self, name: Digest, n_bytes: u64) {
        self.n_uses += 1;
        self.there.insert(name, There { n_bytes, last_use: self.n_uses });
    }

    /// Those used longest ago, without `spared`, until the others take up no more than `room`; or all of them.
    fn leaving(&self, room: u64, spared: &BTreeSet<Digest>) -> Vec<Digest> {
        let mut others: Vec<(&Digest, &There)> =
            self.there.iter().filter(|(name, _)| !spared.contains(*name)).collect();
        others.sort_by_key(|(_, there)| there.last_use);
        let mut n_bytes = self.n_bytes();
        let mut leaving = Vec::new();
        for (name, there) in others {
            if n_bytes <= room {
                break;
            }
            n_bytes -= there.n_bytes;
            leaving.push(*name);
        }
        leaving
    }
}

impl Archive {
    /// Whether bodies are kept.
    pub(crate) fn keeps_bodies(&self) -> bool {
        self.bodies.are_kept()
    }

    /// The names of a generation's bodies, if bodies are kept and its mesh is.
    pub(crate) fn body_names(&self, params: &BuildParams, recipe: &Recipe) -> Option<BodyNames> {
        if !self.keeps_bodies() {
            return None;
        }
        let mesh = self.lock().known_name(recipe.state.base().mesh())?;
        let params = snapshot::params_digest(&ParamsRecord::new(params)).ok()?;
        BodyNames::of(&params, &RecipeRecord::new(recipe, mesh)).ok()
    }

    /// A base body by its name, if it is there and whole.
    pub(crate) fn kept_base(&self, name: &Digest) -> Option<BaseSnapshot> {
        self.kept(name, snapshot::decode_base)
    }

    /// A generation by its name, if it is there and whole.
    pub(crate) fn kept_generation(&self, name: &Digest) -> Option<GenerationSnapshot> {
        self.kept(name, snapshot::decode_generation)
    }

    fn kept<T>(
        &self,
        name: &Digest,
        decode: impl Fn(&Digest, &[u8]) -> Result<T, Unreadable>,
    ) -> Option<T> {
        let decoded = decode(name, &self.bodies.get(name)?);
        decoded.inspect_err(|error| self.bodies.remove_damaged(name, error)).ok()
    }

    /// What was kept under this name is no such body.
    pub(crate) fn not_that_body(&self, name: &Digest, why: &dyn std::fmt::Display) {
        self.bodies.remove_damaged(name, why);
    }

    /// The session uses the bodies of its generations, as its journal tells of them.
    pub(super) fn use_bodies_of(&self, id: SessionId, contents: &Contents) {
        if !self.keeps_bodies() {
            return;
        }
        match names_of(contents) {
            Ok(names) => self.bodies.set_used(id, names),
            Err(error) => tracing::warn!(session = %id, %error, "bodies cannot be named"),
        }
    }
}

/// The names of all bodies that a journal tells of.
fn names_of(contents: &Contents) -> Result<BTreeSet<Digest>, Unreadable> {
    let session = &contents.session;
    let params = snapshot::params_digest(&session.params)?;
    let built = RecipeRecord::of_build(session.mesh, &session.params);
    let later = contents.generations.iter().map(|generation| &generation.recipe);
    let mut names = BTreeSet::new();
    for recipe in later.chain([&built]) {
        let BodyNames { base, own } = BodyNames::of(&params, recipe)?;
        names.extend([base, own]);
    }
    Ok(names)
}

impl Journal {
    /// From now on the session uses the bodies of `generations` and no others. Returns their names, if bodies
    /// are kept.
    pub(super) fn use_bodies<'a>(
        &self,
        generations: &'a [Arc<Generation>],
    ) -> Vec<(&'a Artifacts, BodyNames)> {
        let Journal { archive, id, .. } = self;
        let named = |generation: &'a Arc<Generation>| {
            let body = &*generation.artifacts;
            Some((body, archive.body_names(body.params(), &body.recipe())?))
        };
        let named: Vec<(&Artifacts, BodyNames)> = generations.iter().filter_map(named).collect();
        // So that no session uses any that is gone.
        let tail = self.lock();
        if self.check(&tail).is_err() {
            return Vec::new();
        }
        let all = named.iter().flat_map(|(_, names)| [names.base, names.own]).collect();
        archive.bodies.set_used(*id, all);
        named
    }

    /// Keeps the bodies of `generations`, as far as there is room for them, the last ones first, and no others of the
    /// session's. Stops when `goes_on` says so.
    pub(crate) fn keep_bodies(
        &self,
        generations: &[Arc<Generation>],
        goes_on: &dyn Fn() -> bool,
    ) -> Result<(), StoreError> {
        for (body, names) in self.use_bodies(generations).into_iter().rev() {
            let base = || snapshot::encode_base(&names.base, &body.base_body().snapshot());
            let own = || snapshot::encode_generation(&names.own, &body.snapshot());
            let is_kept = goes_on()
                && self.keep_body(names.base, base)?
                && goes_on()
                && self.keep_body(names.own, own)?;
            if !is_kept {
                break;
            }
        }
        Ok(())
    }

    /// Tells whether the body is kept now.
    fn keep_body(
        &self,
        name: Digest,
        encode: impl FnOnce() -> Result<Vec<u8>, Unreadable>,
    ) -> Result<bool, StoreError> {
        let bodies = &self.archive.bodies;
        if bodies.has(&name) {
            return Ok(true);
        }
        let is_kept = bodies.put(self.id, name, &encode().map_err(unwritable)?)?;
        if !is_kept {
            tracing::debug!(session = %self.id, "no room to keep a body");
        }
        Ok(is_kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::LocalFiles;

    fn id(n: u128) -> SessionId {
        format!("{n:032x}").parse().unwrap()
    }

    fn name(n: u8) -> Digest {
        [n; 32]
    }

    fn there(bodies: &Bodies) -> Vec<u8> {
        let of_index: Vec<u8> = bodies.lock().there.keys().map(|name| name[0]).collect();
        let of_storage = bodies.storage.list(BODIES).unwrap();
        assert_eq!(
            of_storage.iter().map(|entry| &*entry.name).collect::<Vec<_>>(),
            of_index.iter().map(|n| blob(&name(*n))).collect::<Vec<_>>()
        );
        of_index
    }

    fn opened(folder: &std::path::Path, max_bytes: u64) -> Bodies {
        Bodies::new(Arc::new(LocalFiles::open(folder).unwrap()), max_bytes)
    }

    #[test]
    fn those_used_last_stay_within_the_room() {
        let folder = tempfile::tempdir().unwrap();
        let bodies = opened(folder.path(), 100);
        let put =
            |of: u128, n: u8, size: usize| bodies.put(id(of), name(n), &vec![n; size]).unwrap();
        bodies.set_used(id(1), [1, 2, 3].map(name).into());
        bodies.set_used(id(2), [3, 4, 5, 6].map(name).into());
        // What nobody has said to use is not kept, nor what has no room at all.
        assert!(!put(1, 4, 1) && !put(1, 1, 101));
        assert!(put(1, 1, 40) && put(1, 2, 30) && put(2, 3, 20));
        assert_eq!(bodies.get(&name(1)).unwrap(), [1; 40]);
        assert!(put(2, 4, 30));
        assert_eq!(there(&bodies), [1, 3, 4]);
        // A session's own do not make room for each other.
        assert!(!put(2, 5, 80));
        assert_eq!(there(&bodies), [1, 3, 4]);
        assert!(put(2, 6, 50));
        assert_eq!(there(&bodies), [3, 4, 6]);
        // They go with the last session that uses them.
        bodies.set_used(id(1), BTreeSet::new());
        assert_eq!(there(&bodies), [3, 4, 6]);
        bodies.set_used(id(2), [name(4), name(6)].into());
        assert_eq!(there(&bodies), [4, 6]);
        assert!(bodies.give_way());
        assert_eq!(there(&bodies), [6]);
        bodies.remove_damaged(&name(6), &"a test");
        assert!(!bodies.has(&name(6)) && !bodies.give_way());
        assert_eq!(there(&bodies), [0; 0]);
    }

    #[test]
    fn a_start_finds_them_and_clears_away_what_nobody_uses() {
        let folder = tempfile::tempdir().unwrap();
        let bodies = opened(folder.path(), 100);
        bodies.set_used(id(1), [1, 2, 3].map(name).into());
        for n in 1..4 {
            assert!(bodies.put(id(1), name(n), &[n; 20]).unwrap());
        }
        drop(bodies);
        let found = |max_bytes: u64, names: &[u8], all_users: bool| {
            let bodies = opened(folder.path(), max_bytes);
            bodies.set_used(id(1), names.iter().map(|n| name(*n)).collect());
            bodies.find(all_users).unwrap();
            bodies.storage.list(BODIES).unwrap().len()
        };
        // Whether anybody uses the others is not known.
        assert_eq!(found(100, &[1], false), 3);
        assert_eq!(found(100, &[1, 3], true), 2);
        assert_eq!(found(20, &[1, 3], true), 1);
        assert_eq!(found(0, &[1, 3], false), 0);
    }
}
