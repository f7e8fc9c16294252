//! Sessions on a [`Storage`].
//!
//! `sessions/<id>` is a session's journal: records, each with a checksum ([`frame`]). The first says what
//! the session began with, each further one of a generation is complete in itself ([`record`]): the
//! last ones are enough, and a damaged one costs its own generation alone. `meshes/<sha-256>` are
//! meshes, under the name of their contents, shared by the sessions that name them.
//!
//! `bodies/<sha-256>` are prepared bodies ([`snapshot`]): what makes a restoration quick, and no more.
//!
//! A session exists while its journal does. Meshes are written before the journal that names them and
//! deleted after it.
//!
//! Where the storage is shared, a journal has to be this process's before anything is made of it, and
//! whether another daemon's session names a mesh cannot be known: there each session has meshes of its own,
//! `meshes/<id>/<sha-256>`.

mod bodies;
pub(crate) mod frame;
pub(crate) mod generation;
pub(crate) mod record;
pub(crate) mod snapshot;

use crate::error::StoreError;
use crate::metrics;
use crate::session::{Generation, MeshSize, SessionId};
use crate::simulation::SimulationConfig;
use crate::storage::{Entry, Storage, StorageError};
use bodies::Bodies;
use frame::Digest;
use generation::GenerationRecord;
use record::{
    MeshRecord, ParamsRecord, Record, SessionRecord, SimulationRecord, SizeRecord, Unreadable,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant, SystemTime};
use sutura_core::build::BuildParams;
use sutura_core::mesh::TetMesh;

const SESSIONS: &str = "sessions";
const MESHES: &str = "meshes";

/// Generations in a journal, as a multiple of those that are kept, beyond which the old ones are left out.
const COMPACTION_FACTOR: usize = 4;

/// Age at which a mesh of no session is cleared away from a shared storage: far longer than a session takes to
/// begin ([`MAX_BEGINNING`]), so that none is that another daemon is about to name.
const ORPHAN_AGE: Duration = Duration::from_secs(24 * 3600);

/// Longest time from the first mesh of a session to its journal.
const MAX_BEGINNING: Duration = Duration::from_secs(3600);

/// Every session of a storage. Calls block: they belong on a pool.
#[derive(Debug)]
pub(crate) struct Archive {
    storage: Arc<dyn Storage>,
    /// Locked while a mesh is written or deleted, so that none is deleted that is about to be named.
    meshes: Mutex<Meshes>,
    bodies: Bodies,
}

#[derive(Debug, Default)]
struct Meshes {
    /// The meshes there are, with the sessions that name them.
    users: BTreeMap<Digest, BTreeSet<SessionId>>,
    /// Those found damaged: they are written again when somebody brings them.
    damaged: BTreeSet<Digest>,
    /// Names of meshes in memory.
    known: Vec<(Weak<TetMesh>, Digest)>,
}

/// A session as its journal tells of it, without its body.
pub(crate) struct Found {
    pub(crate) journal: Journal,
    /// When it was changed last.
    pub(crate) modified: Option<SystemTime>,
    /// What is in it, unless that cannot be read.
    pub(crate) contents: Result<Contents, StoreError>,
}

/// What a journal says.
pub(crate) struct Contents {
    pub(crate) session: SessionRecord,
    /// In the order of their numbers.
    pub(crate) generations: Vec<GenerationRecord>,
    pub(crate) seams: Vec<[u32; 2]>,
    pub(crate) simulation: Option<SimulationConfig>,
}

impl Contents {
    /// The number of the current generation.
    pub(crate) fn generation(&self) -> u64 {
        self.generations.last().map_or(0, |generation| generation.number)
    }

    pub(crate) fn size(&self) -> MeshSize {
        let SizeRecord { n_vertices, n_tets, n_domains, n_components } = self.session.size;
        let of = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
        MeshSize {
            n_vertices: of(n_vertices),
            n_tets: of(n_tets),
            n_domains: of(n_domains),
            n_components: of(n_components),
        }
    }

    fn meshes(&self) -> impl Iterator<Item = Digest> {
        let of_generations = self.generations.iter().map(|generation| generation.recipe.mesh);
        of_generations.chain([self.session.mesh])
    }
}

/// A session's name and what generations it begins with.
pub(crate) struct Beginning<'a> {
    pub(crate) name: &'a str,
    pub(crate) tenant: Option<&'a str>,
    pub(crate) mesh: &'a Arc<TetMesh>,
    pub(crate) params: &'a BuildParams,
    pub(crate) generations: Vec<Arc<Generation>>,
    pub(crate) seams: Vec<[u32; 2]>,
}

fn journal_name(id: SessionId) -> String {
    format!("{SESSIONS}/{id}")
}

/// The session that an entry's name ends with.
fn session_of(name: &str, folder: &str) -> Option<SessionId> {
    name.strip_prefix(folder)?.strip_prefix('/')?.parse().ok()
}

fn damaged(name: &str, why: impl std::fmt::Display) -> StoreError {
    StoreError::Damaged { name: name.to_owned(), why: why.to_string() }
}

fn unwritable(error: Unreadable) -> StoreError {
    tracing::error!(%error, "a record could not be written");
    StoreError::Failed { what: "writing a record" }
}

impl Archive {
    /// Finds every session, and clears away meshes and bodies that none of them names. Bodies may take up
    /// `max_body_bytes`.
    pub(crate) fn open(
        storage: Arc<dyn Storage>,
        max_body_bytes: u64,
    ) -> Result<(Arc<Archive>, Vec<Found>), StorageError> {
        let bodies = Bodies::new(storage.clone(), max_body_bytes);
        let archive = Arc::new(Archive { storage, meshes: Mutex::default(), bodies });
        let mut found = Vec::new();
        for entry in archive.storage.own(SESSIONS)? {
            let Some(id) = session_of(&entry.name, SESSIONS) else {
                tracing::warn!(name = entry.name, "no journal of a session; left alone");
                continue;
            };
            // `None`: gone meanwhile, by another daemon.
            if let Some(session) = archive.claim(id)? {
                found.push(Found { modified: entry.modified, ..session });
            }
        }
        let all_are_read = found.iter().all(|found| found.contents.is_ok());
        if archive.storage.is_shared() {
            archive.sweep_orphans()?;
        } else if all_are_read {
            archive.sweep()?;
        }
        archive.bodies.find(all_are_read)?;
        Ok((archive, found))
    }

    /// Whether other daemons use the storage, too.
    pub(crate) fn is_shared(&self) -> bool {
        self.storage.is_shared()
    }

    /// Whose a session of the storage is, wherever it is served; `None` if there is none.
    pub(crate) fn tenant(&self, id: SessionId) -> Result<Option<Option<String>>, StoreError> {
        let name = journal_name(id);
        let peeked = self.storage.peek(&name).map_err(|error| match error.is_damaged() {
            true => damaged(&name, error),
            false => error.into(),
        });
        let Some(bytes) = peeked? else { return Ok(None) };
        read(&name, &frame::frames(&bytes)).map(|contents| Some(contents.session.tenant))
    }

    /// Makes a session this process's; `None` if there is none.
    pub(crate) fn claim(self: &Arc<Self>, id: SessionId) -> Result<Option<Found>, StorageError> {
        let name = journal_name(id);
        let Some(bytes) = self.storage.claim(&name)? else { return Ok(None) };
        let read = frame::frames(&bytes);
        if read.end < bytes.len() {
            let n_bytes = bytes.len() - read.end;
            tracing::warn!(session = %id, n_bytes, "the journal ends in a damaged part, which is cut off");
        }
        if read.n_damaged > 0 {
            let n_places = read.n_damaged;
            tracing::error!(session = %id, n_places, "the journal is damaged in its midst: generations are missing");
        }
        let contents = self::read(&name, &read);
        if let Ok(contents) = &contents {
            self.lock().use_meshes(id, contents.meshes());
            self.use_bodies_of(id, contents);
        }
        let n_generations = contents.as_ref().map_or(0, |c| c.generations.len());
        let journal = Journal::new(self, id, read.end as u64, n_generations);
        Ok(Some(Found { journal, modified: None, contents }))
    }

    /// Where a session's mesh is kept.
    fn mesh_name(&self, id: SessionId, mesh: &Digest) -> String {
        match self.is_shared() {
            true => format!("{MESHES}/{id}/{}", frame::hex(mesh)),
            false => format!("{MESHES}/{}", frame::hex(mesh)),
        }
    }

    /// Clears away from a shared storage what crashes left behind: old meshes of sessions without a journal.
    fn sweep_orphans(&self) -> Result<(), StorageError> {
        let is_old = |entry: &Entry| {
            let age = entry.modified.and_then(|modified| modified.elapsed().ok());
            age.is_some_and(|age| age > ORPHAN_AGE)
        };
        let old: Vec<Entry> = self.storage.list(MESHES)?.into_iter().filter(is_old).collect();
        // Behind the meshes: a session that is not there now never will be.
        let journals = self.storage.list(SESSIONS)?;
        let sessions: BTreeSet<SessionId> =
            journals.iter().filter_map(|entry| session_of(&entry.name, SESSIONS)).collect();
        for Entry { name, .. } in old {
            let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
            if session_of(folder, MESHES).is_some_and(|id| !sessions.contains(&id)) {
                tracing::info!(name, "a mesh of no session is cleared away");
                self.storage.delete(&name)?;
            }
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Meshes> {
        self.meshes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn sweep(&self) -> Result<(), StorageError> {
        let meshes = self.lock();
        let name = |mesh: &Digest| format!("{MESHES}/{}", frame::hex(mesh));
        let names: BTreeSet<String> = meshes.users.keys().map(name).collect();
        for entry in self.storage.list(MESHES)? {
            if !names.contains(&entry.name) {
                tracing::info!(name = entry.name, "a mesh of no session is cleared away");
                self.storage.delete(&entry.name)?;
            }
        }
        Ok(())
    }

    /// Begins a session's journal; the session lasts once this has returned.
    pub(crate) fn begin(
        self: &Arc<Self>,
        id: SessionId,
        beginning: &Beginning<'_>,
    ) -> Result<Journal, StoreError> {
        let Beginning { name, tenant, mesh, params, generations, seams } = beginning;
        let begun = Instant::now();
        let MeshSize { n_vertices, n_tets, n_domains, n_components } = MeshSize::of(mesh);
        let session = Record::Session(Box::new(SessionRecord {
            name: (*name).to_owned(),
            tenant: tenant.map(str::to_owned),
            mesh: self.mesh_name_of(id, mesh)?,
            size: SizeRecord {
                n_vertices: n_vertices as u64,
                n_tets: n_tets as u64,
                n_domains: n_domains as u64,
                n_components: n_components as u64,
            },
            params: ParamsRecord::new(params),
        }));
        let mut bytes = framed(&session)?;
        for generation in generations {
            bytes.extend(framed(&self.generation_record(id, generation)?)?);
        }
        if !seams.is_empty() {
            bytes.extend(framed(&Record::Seams(seams.clone()))?);
        }
        if let Err(error) = self.with_room(|| self.storage.begin(&journal_name(id), &bytes)) {
            // A shared one may have heard all the same: its journal, if it comes to be, finds its mesh.
            if !self.is_shared() {
                self.forget(id);
            }
            return Err(error.into());
        }
        let journal = Journal::new(self, id, bytes.len() as u64, generations.len());
        if begun.elapsed() > MAX_BEGINNING {
            journal.delete()?;
            return Err(StoreError::Cancelled);
        }
        journal.use_bodies(generations);
        Ok(journal)
    }

    fn generation_record(
        &self,
        id: SessionId,
        generation: &Generation,
    ) -> Result<Record, StoreError> {
        let recipe = generation.artifacts.recipe();
        let mesh = self.mesh_name_of(id, recipe.state.base().mesh())?;
        Ok(Record::Generation(Box::new(GenerationRecord::new(generation, &recipe, mesh))))
    }

    /// The name under which the mesh is kept, from now on if it was not yet.
    fn mesh_name_of(&self, id: SessionId, mesh: &Arc<TetMesh>) -> Result<Digest, StoreError> {
        let mut meshes = self.lock();
        let user = self.is_shared().then_some(id);
        let name = match meshes.known_name(mesh).filter(|name| meshes.has(name, user)) {
            Some(name) => name,
            None => {
                let contents = record::encode(&MeshRecord::new(mesh)).map_err(unwritable)?;
                let name = frame::digest(&contents);
                if !meshes.has(&name, user) {
                    let bytes = frame::frame(&contents);
                    self.with_room(|| self.storage.put(&self.mesh_name(id, &name), &bytes))?;
                    meshes.damaged.remove(&name);
                }
                meshes.known.retain(|(known, _)| known.strong_count() > 0);
                meshes.known.push((Arc::downgrade(mesh), name));
                name
            }
        };
        meshes.use_meshes(id, [name]);
        Ok(name)
    }

    /// A session's mesh by its name.
    fn mesh(&self, id: SessionId, name: &Digest) -> Result<Arc<TetMesh>, StoreError> {
        let in_memory = |meshes: &Meshes| {
            let known = meshes.known.iter().filter(|(_, known)| known == name);
            known.filter_map(|(mesh, _)| mesh.upgrade()).next()
        };
        if let Some(mesh) = in_memory(&self.lock()) {
            return Ok(mesh);
        }
        let blob = self.mesh_name(id, name);
        let read = || {
            let bytes = self.storage.get(&blob)?.ok_or_else(|| damaged(&blob, "it is missing"))?;
            let read = frame::frames(&bytes);
            let contents = match read.whole[..] {
                [contents] if frame::digest(contents) == *name => contents,
                _ if read.has_other_version => {
                    return Err(damaged(&blob, "it was written by another version"));
                }
                _ => return Err(damaged(&blob, "its checksum is wrong")),
            };
            let mesh = record::decode::<MeshRecord>(contents).and_then(MeshRecord::mesh);
            mesh.map(Arc::new).map_err(|error| damaged(&blob, error))
        };
        let mesh = read();
        let mut meshes = self.lock();
        match &mesh {
            Ok(mesh) => meshes.known.push((Arc::downgrade(mesh), *name)),
            Err(StoreError::Damaged { .. }) => {
                meshes.damaged.insert(*name);
            }
            Err(_) => {}
        }
        mesh
    }

    /// Writes something that cannot be made again: bodies, which can, make room for it.
    fn with_room(&self, write: impl Fn() -> Result<(), StorageError>) -> Result<(), StorageError> {
        loop {
            match write() {
                Err(error) if error.is_full() && self.bodies.give_way() => {}
                written => return written,
            }
        }
    }

    /// Clears away the meshes and bodies that only this session named.
    fn forget(&self, id: SessionId) {
        self.bodies.set_used(id, BTreeSet::new());
        let mut meshes = self.lock();
        for name in meshes.stop_using(id, self.is_shared()) {
            if let Err(error) = self.storage.delete(&self.mesh_name(id, &name)) {
                // A later start tries again.
                tracing::warn!(%error, "a mesh of no session is left behind");
            }
        }
    }
}

impl Meshes {
    /// The name of a mesh in memory, once it was kept.
    fn known_name(&self, mesh: &Arc<TetMesh>) -> Option<Digest> {
        // A pointer is not given to another mesh while somebody holds a weak one.
        let known = self.known.iter().find(|(known, _)| known.as_ptr() == Arc::as_ptr(mesh));
        known.map(|(_, name)| *name)
    }

    /// Whether the mesh is there for any session, or for this `user`.
    fn has(&self, name: &Digest, user: Option<SessionId>) -> bool {
        let users = self.users.get(name);
        users.is_some_and(|users| user.is_none_or(|user| users.contains(&user)))
            && !self.damaged.contains(name)
    }

    /// The meshes that the session named, those of others left out unless `all`.
    fn stop_using(&mut self, id: SessionId, all: bool) -> Vec<Digest> {
        let mut left = Vec::new();
        self.users.retain(|name, users| {
            if users.remove(&id) && (all || users.is_empty()) {
                left.push(*name);
            }
            !users.is_empty()
        });
        left
    }

    fn use_meshes(&mut self, id: SessionId, names: impl IntoIterator<Item = Digest>) {
        for name in names {
            self.users.entry(name).or_default().insert(id);
        }
    }
}

fn framed(record: &Record) -> Result<Vec<u8>, StoreError> {
    record::encode(record).map(|contents| frame::frame(&contents)).map_err(unwritable)
}

/// What a journal's records say.
pub(crate) fn read(name: &str, read: &frame::Frames<'_>) -> Result<Contents, StoreError> {
    if read.has_other_version {
        return Err(damaged(name, "it was written by another version"));
    }
    let mut records = read.whole.iter().map(|contents| record::decode::<Record>(contents));
    let first = records.next().transpose().map_err(|error| damaged(name, error))?;
    let Some(Record::Session(session)) = first else {
        return Err(damaged(name, "its beginning cannot be read"));
    };
    let mut contents = Contents {
        session: *session,
        generations: Vec::new(),
        seams: Vec::new(),
        simulation: None,
    };
    let mut generations = BTreeMap::new();
    for record in records {
        match record.map_err(|error| damaged(name, error))? {
            Record::Session(_) => return Err(damaged(name, "it begins twice")),
            Record::Generation(generation) => {
                generations.insert(generation.number, *generation);
            }
            Record::Seams(pairs) => contents.seams.extend(pairs),
            Record::Simulation(simulation) => {
                contents.simulation = simulation.as_ref().map(SimulationRecord::config);
            }
        }
    }
    contents.generations = generations.into_values().collect();
    Ok(contents)
}

/// A session's journal. A record that could not be written whole is as if it had never been.
#[derive(Debug)]
pub(crate) struct Journal {
    archive: Arc<Archive>,
    id: SessionId,
    tail: Mutex<Tail>,
}

#[derive(Debug)]
struct Tail {
    /// Where the last whole record ends.
    end: u64,
    n_generations: usize,
    is_deleted: bool,
    /// Another daemon serves the session now.
    is_taken: bool,
}

impl Journal {
    fn new(archive: &Arc<Archive>, id: SessionId, end: u64, n_generations: usize) -> Journal {
        let tail = Tail { end, n_generations, is_deleted: false, is_taken: false };
        Journal { archive: archive.clone(), id, tail: Mutex::new(tail) }
    }

    /// A mesh that the session names.
    pub(crate) fn mesh(&self, name: &Digest) -> Result<Arc<TetMesh>, StoreError> {
        self.archive.mesh(self.id, name)
    }

    pub(crate) fn id(&self) -> SessionId {
        self.id
    }

    fn lock(&self) -> MutexGuard<'_, Tail> {
        self.tail.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes a generation last.
    pub(crate) fn add_generation(&self, generation: &Generation) -> Result<(), StoreError> {
        let record = self.archive.generation_record(self.id, generation)?;
        self.append(&record)
    }

    /// Makes the names of candidate pairs last.
    pub(crate) fn add_seams(&self, pairs: &[[u32; 2]]) -> Result<(), StoreError> {
        self.append(&Record::Seams(pairs.to_vec()))
    }

    /// Makes it last how the session is simulated, if it is.
    pub(crate) fn set_simulation(
        &self,
        config: Option<&SimulationConfig>,
    ) -> Result<(), StoreError> {
        self.append(&Record::Simulation(config.map(SimulationRecord::new)))
    }

    fn append(&self, record: &Record) -> Result<(), StoreError> {
        let bytes = framed(record)?;
        let mut tail = self.lock();
        self.check(&tail)?;
        let begun = Instant::now();
        let append = || self.archive.storage.append(&journal_name(self.id), tail.end, &bytes);
        let appended = self.archive.with_room(append);
        self.heed(&mut tail, appended)?;
        metrics::journal_written(begun.elapsed());
        tail.end += bytes.len() as u64;
        tail.n_generations += usize::from(matches!(record, Record::Generation(_)));
        Ok(())
    }

    fn check(&self, tail: &Tail) -> Result<(), StoreError> {
        match tail {
            Tail { is_deleted: true, .. } => Err(StoreError::NoSession(self.id)),
            Tail { is_taken: true, .. } => Err(StoreError::Taken(self.id)),
            _ => Ok(()),
        }
    }

    /// Remembers that another daemon has the session now, if that is why nothing was written.
    fn heed(&self, tail: &mut Tail, written: Result<(), StorageError>) -> Result<(), StoreError> {
        match written {
            Err(error) if error.is_taken() => {
                tail.is_taken = true;
                Err(StoreError::Taken(self.id))
            }
            written => Ok(written?),
        }
    }

    /// Whether another daemon has the session now, as far as is known here.
    pub(crate) fn is_taken(&self) -> bool {
        self.lock().is_taken
    }

    /// Looks whether another daemon has the session now.
    pub(crate) fn look(&self) -> Result<bool, StorageError> {
        if !self.archive.storage.is_held(&journal_name(self.id))? {
            let mut tail = self.lock();
            tail.is_taken = !tail.is_deleted;
        }
        Ok(self.is_taken())
    }

    /// Whatever is known of the session's meshes here is no longer.
    pub(crate) fn let_go(&self) {
        self.archive.lock().stop_using(self.id, true);
    }

    /// What the journal says now.
    pub(crate) fn read(&self) -> Result<Contents, StoreError> {
        let end = {
            let tail = self.lock();
            self.check(&tail)?;
            tail.end
        };
        self.read_until(end)
    }

    fn read_until(&self, end: u64) -> Result<Contents, StoreError> {
        let name = journal_name(self.id);
        let bytes = self.archive.storage.peek(&name)?;
        let bytes = bytes.ok_or_else(|| damaged(&name, "it is missing"))?;
        let end = usize::try_from(end).unwrap_or(usize::MAX).min(bytes.len());
        read(&name, &frame::frames(&bytes[..end]))
    }

    /// Whether the journal holds many more generations than the session keeps.
    pub(crate) fn is_long(&self, n_kept: usize) -> bool {
        self.lock().n_generations > n_kept * COMPACTION_FACTOR
    }

    /// Leaves out the generations that the session keeps no longer.
    pub(crate) fn compact(&self, n_kept: usize) -> Result<(), StoreError> {
        let mut tail = self.lock();
        self.check(&tail)?;
        let mut contents = self.read_until(tail.end)?;
        let n_dropped = contents.generations.len().saturating_sub(n_kept);
        contents.generations.drain(..n_dropped);
        let n_generations = contents.generations.len();
        let mut records = vec![Record::Session(Box::new(contents.session))];
        records.extend(contents.generations.into_iter().map(|g| Record::Generation(Box::new(g))));
        if !contents.seams.is_empty() {
            records.push(Record::Seams(contents.seams));
        }
        if let Some(config) = &contents.simulation {
            records.push(Record::Simulation(Some(SimulationRecord::new(config))));
        }
        let mut bytes = Vec::new();
        for record in &records {
            bytes.extend(framed(record)?);
        }
        let rewrite = || self.archive.storage.rewrite(&journal_name(self.id), &bytes);
        let written = self.archive.with_room(rewrite);
        self.heed(&mut tail, written)?;
        *tail = Tail { end: bytes.len() as u64, n_generations, ..*tail };
        Ok(())
    }

    /// Ends the session for good.
    pub(crate) fn delete(&self) -> Result<(), StoreError> {
        let mut tail = self.lock();
        if !tail.is_deleted {
            let removed = self.archive.storage.remove(&journal_name(self.id));
            self.heed(&mut tail, removed)?;
            tail.is_deleted = true;
            self.archive.forget(self.id);
        }
        Ok(())
    }
}
