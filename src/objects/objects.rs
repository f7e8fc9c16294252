//! Blobs and journals as objects.

use crate::header::Header;
use futures_util::TryStreamExt as _;
use futures_util::stream::{self, StreamExt as _};
use object_store::path::Path;
use object_store::{
    Error, GetOptions, ObjectStore, ObjectStoreExt as _, PutMode, PutOptions, UpdateVersion,
};
use std::collections::HashMap;
use std::fmt;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::{Duration, Instant, SystemTime};
use sutura_store::{Entry, Storage, StorageError, Taken};
use tokio::runtime::Runtime;

/// Says whose objects these are, and in which form.
const FORMAT: &str = "format";
const FORMAT_TEXT: &str = "sutura objects 1\n";

/// An ETag that no object has.
const NO_E_TAG: &str = "\"00000000000000000000000000000000\"";

/// Longest time that one call takes, however many requests it is.
const MAX_WAIT: Duration = Duration::from_secs(40);

/// Times a journal's write is sent: again after an answer that was lost, or a write of one's own that was
/// given up and arrived all the same.
const MAX_ATTEMPTS: u32 = 4;

/// Time after which it is not sent again.
const MAX_RETRY_TIME: Duration = Duration::from_secs(10);

/// Wait before the second of them; it doubles from one to the next.
const FIRST_PAUSE: Duration = Duration::from_millis(if cfg!(test) { 1 } else { 100 });

/// Times a journal is read anew for being claimed, while its owner writes to it.
const MAX_CLAIMS: usize = 16;

/// Journals that are read at the same time at the start.
const N_READS: usize = 16;

/// A bucket, or a part of one, shared by the daemons of a fleet.
pub struct Objects {
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    /// This process, by a name of its own.
    writer: String,
    /// The daemon, by a name that lasts.
    daemon: String,
    n_writes: AtomicU64,
    /// The journals that are this process's, as it wrote them last.
    held: Mutex<HashMap<String, Arc<Mutex<Held>>>>,
    /// `None` once dropped.
    runtime: Option<Runtime>,
}

/// A journal of this process's.
struct Held {
    records: Vec<u8>,
    version: UpdateVersion,
    /// Taken over by another one, or removed.
    is_gone: bool,
}

/// What a journal's write may go over beside the version that it names.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Over {
    /// Writes of this process: none has been acknowledged since.
    Own,
    Nothing,
}

/// An object as it was read.
struct Object {
    bytes: Vec<u8>,
    version: UpdateVersion,
}

impl fmt::Debug for Objects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Objects { prefix, writer, daemon, .. } = self;
        f.debug_struct("Objects")
            .field("prefix", prefix)
            .field("writer", writer)
            .field("daemon", daemon)
            .finish_non_exhaustive()
    }
}

impl Drop for Objects {
    fn drop(&mut self) {
        // Without waiting, which a thread of another runtime may not.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn failed(action: &'static str, name: &str, source: io::Error) -> StorageError {
    StorageError { action, name: name.to_owned(), source }
}

fn failing(action: &'static str, name: &str) -> impl FnOnce(Error) -> StorageError {
    let name = name.to_owned();
    move |error| failed(action, &name, of_store(error))
}

fn of_store(error: Error) -> io::Error {
    let kind = match &error {
        Error::NotFound { .. } => io::ErrorKind::NotFound,
        Error::AlreadyExists { .. } => io::ErrorKind::AlreadyExists,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            io::ErrorKind::PermissionDenied
        }
        _ => io::ErrorKind::Other,
    };
    io::Error::new(kind, error)
}

fn taken(action: &'static str, name: &str) -> StorageError {
    failed(action, name, io::Error::other(Taken))
}

fn damaged(action: &'static str, name: &str, why: String) -> StorageError {
    failed(action, name, io::Error::new(io::ErrorKind::InvalidData, why))
}

impl Objects {
    /// Takes the objects below `prefix` for a daemon of this name, after the store has shown that it keeps to the
    /// conditions of a put: one that did not would lose what was acknowledged.
    pub fn open(
        store: Arc<dyn ObjectStore>,
        prefix: &str,
        daemon: &str,
    ) -> Result<Objects, StorageError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("objects")
            .enable_all()
            .build()
            .map_err(|error| failed("opening", "the object store", error))?;
        let objects = Objects {
            store,
            prefix: Path::from(prefix),
            writer: uuid::Uuid::new_v4().simple().to_string(),
            daemon: daemon.to_owned(),
            n_writes: AtomicU64::new(0),
            held: Mutex::default(),
            runtime: Some(runtime),
        };
        objects.check()?;
        Ok(objects)
    }

    fn check(&self) -> Result<(), StorageError> {
        let text = FORMAT_TEXT.as_bytes();
        let lawless = |header: &str| {
            let why = format!(
                "it does not keep to {header}: two daemons could both write to one session"
            );
            failed("opening", "the object store", io::Error::new(io::ErrorKind::Unsupported, why))
        };
        match self.put_if(FORMAT, text.to_vec(), PutMode::Create)? {
            Ok(_) => match self.put_if(FORMAT, text.to_vec(), PutMode::Create)? {
                Err(Error::AlreadyExists { .. }) => {}
                Ok(_) => return Err(lawless("If-None-Match")),
                Err(error) => return Err(failing("opening", FORMAT)(error)),
            },
            Err(Error::AlreadyExists { .. }) => {}
            Err(error) => return Err(failing("opening", FORMAT)(error)),
        }
        let found = self.read("opening", FORMAT)?.map(|object| object.bytes).unwrap_or_default();
        if found != text {
            let found = String::from_utf8_lossy(&found[..found.len().min(64)]).into_owned();
            let why = format!("its form is {found:?}, this version reads {FORMAT_TEXT:?}");
            return Err(damaged("opening", FORMAT, why));
        }
        let version = UpdateVersion { e_tag: Some(NO_E_TAG.to_owned()), version: None };
        match self.put_if(FORMAT, text.to_vec(), PutMode::Update(version))? {
            Err(Error::Precondition { .. }) => Ok(()),
            Ok(_) => Err(lawless("If-Match")),
            Err(error) => Err(failing("opening", FORMAT)(error)),
        }
    }

    /// Runs requests on the runtime while this thread waits.
    fn wait<T: Send + 'static>(
        &self,
        action: &'static str,
        name: &str,
        requests: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, StorageError> {
        let (send, receive) = mpsc::sync_channel(1);
        let Some(runtime) = &self.runtime else {
            return Err(failed(action, name, io::ErrorKind::NotConnected.into()));
        };
        runtime.spawn(async move {
            // Nobody listens any more where the process ends.
            let _ = send.send(tokio::time::timeout(MAX_WAIT, requests).await.ok());
        });
        let answer = receive.recv().ok().flatten();
        answer.ok_or_else(|| failed(action, name, io::ErrorKind::TimedOut.into()))
    }

    fn path(&self, name: &str) -> Path {
        Path::from_iter(self.prefix.parts().chain(Path::from(name).parts()))
    }

    /// A put as it was answered.
    fn put_if(
        &self,
        name: &str,
        bytes: Vec<u8>,
        mode: PutMode,
    ) -> Result<Result<UpdateVersion, Error>, StorageError> {
        let (store, path) = (self.store.clone(), self.path(name));
        let options = PutOptions { mode, ..PutOptions::default() };
        self.wait("writing", name, async move {
            store.put_opts(&path, bytes.into(), options).await.map(UpdateVersion::from)
        })
    }

    fn read(&self, action: &'static str, name: &str) -> Result<Option<Object>, StorageError> {
        let read = self.wait(action, name, read(self.store.clone(), self.path(name)))?;
        read.map_err(failing(action, name))
    }

    fn header(&self, is_deleted: bool) -> Header {
        let write = self.n_writes.fetch_add(1, Ordering::Relaxed);
        Header::new(&self.writer, write, &self.daemon, is_deleted)
    }

    fn held(&self) -> MutexGuard<'_, HashMap<String, Arc<Mutex<Held>>>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hold(&self, name: &str, records: Vec<u8>, version: UpdateVersion) {
        let held = Held { records, version, is_gone: false };
        self.held().insert(name.to_owned(), Arc::new(Mutex::new(held)));
    }

    /// Changes a journal of this process's into what `change` makes of it.
    fn replace(
        &self,
        action: &'static str,
        name: &str,
        is_deleted: bool,
        change: impl FnOnce(&[u8]) -> Result<Vec<u8>, io::Error>,
    ) -> Result<(), StorageError> {
        let entry = self.held().get(name).cloned().ok_or_else(|| taken(action, name))?;
        let mut held = entry.lock().unwrap_or_else(PoisonError::into_inner);
        if held.is_gone {
            return Err(taken(action, name));
        }
        let records = change(&held.records).map_err(|error| failed(action, name, error))?;
        let bytes = self
            .header(is_deleted)
            .before(&records)
            .map_err(|error| failed(action, name, error.into()))?;
        let mode = PutMode::Update(held.version.clone());
        match self.write(action, name, &bytes, mode, Over::Own) {
            Ok(version) => {
                held.records = records;
                held.version = version;
                if is_deleted {
                    self.let_go(name, &entry, &mut held);
                }
                Ok(())
            }
            Err(error) => {
                if error.is_taken() {
                    self.let_go(name, &entry, &mut held);
                }
                Err(error)
            }
        }
    }

    /// The journal is this process's no longer.
    fn let_go(&self, name: &str, entry: &Arc<Mutex<Held>>, held: &mut Held) {
        held.is_gone = true;
        let mut all = self.held();
        if all.get(name).is_some_and(|current| Arc::ptr_eq(current, entry)) {
            all.remove(name);
        }
    }

    /// Puts a journal's bytes, which no other write has, in the place of the version that `mode` names; fails
    /// with [`Taken`] if there is another one.
    fn write(
        &self,
        action: &'static str,
        name: &str,
        bytes: &[u8],
        mut mode: PutMode,
        over: Over,
    ) -> Result<UpdateVersion, StorageError> {
        let begun = Instant::now();
        let mut pause = FIRST_PAUSE;
        let mut attempt = 1;
        loop {
            let error = match self.put_if(name, bytes.to_vec(), mode.clone()) {
                Ok(Ok(version)) => return Ok(version),
                Ok(Err(
                    Error::Precondition { .. }
                    | Error::AlreadyExists { .. }
                    | Error::NotFound { .. },
                )) => {
                    // Another's write, or one of ours that was given up, or this one, whose answer was lost.
                    let Some(found) = self.read(action, name)? else {
                        return Err(taken(action, name));
                    };
                    if found.bytes == bytes {
                        return Ok(found.version);
                    }
                    match Header::split(&found.bytes) {
                        Ok((header, _)) if over == Over::Own && header.writer == self.writer => {
                            mode = PutMode::Update(found.version);
                            taken(action, name)
                        }
                        _ => return Err(taken(action, name)),
                    }
                }
                Ok(Err(error)) => failing(action, name)(error),
                Err(error) => error,
            };
            if attempt == MAX_ATTEMPTS || begun.elapsed() > MAX_RETRY_TIME {
                return Err(error);
            }
            attempt += 1;
            std::thread::sleep(pause);
            pause *= 2;
        }
    }
}

async fn read(store: Arc<dyn ObjectStore>, path: Path) -> Result<Option<Object>, Error> {
    let result = match store.get_opts(&path, GetOptions::default()).await {
        Ok(result) => result,
        Err(Error::NotFound { .. }) => return Ok(None),
        Err(error) => return Err(error),
    };
    let version =
        UpdateVersion { e_tag: result.meta.e_tag.clone(), version: result.meta.version.clone() };
    let bytes = result.bytes().await?.to_vec();
    Ok(Some(Object { bytes, version }))
}

impl Storage for Objects {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        Ok(self.read("reading", name)?.map(|object| object.bytes))
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        let written = self.put_if(name, bytes.to_vec(), PutMode::Overwrite)?;
        written.map(drop).map_err(failing("writing", name))
    }

    fn delete(&self, name: &str) -> Result<(), StorageError> {
        let (store, path) = (self.store.clone(), self.path(name));
        match self.wait("deleting", name, async move { store.delete(&path).await })? {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(failing("deleting", name)(error)),
        }
    }

    fn list(&self, prefix: &str) -> Result<Vec<Entry>, StorageError> {
        let (store, path) = (self.store.clone(), self.path(prefix));
        let listed = self.wait("listing", prefix, async move {
            store.list(Some(&path)).try_collect::<Vec<_>>().await
        })?;
        let mut entries: Vec<Entry> = listed
            .map_err(failing("listing", prefix))?
            .into_iter()
            .filter_map(|object| {
                let parts = object.location.prefix_match(&self.prefix)?;
                let name = Path::from_iter(parts).to_string();
                let modified = Some(SystemTime::from(object.last_modified));
                Some(Entry { name, modified, n_bytes: object.size })
            })
            .collect();
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(entries)
    }

    fn append(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        self.replace("appending to", name, false, |records| {
            let kept = usize::try_from(offset).ok().and_then(|offset| records.get(..offset));
            let kept = kept.ok_or_else(|| {
                let why = format!("it has {} bytes, {offset} were written", records.len());
                io::Error::new(io::ErrorKind::InvalidData, why)
            })?;
            Ok([kept, bytes].concat())
        })
    }

    fn is_shared(&self) -> bool {
        true
    }

    fn own(&self, prefix: &str) -> Result<Vec<Entry>, StorageError> {
        let entries = self.list(prefix)?;
        let reads = entries.into_iter().map(|entry| {
            let (store, path) = (self.store.clone(), self.path(&entry.name));
            async move { read(store, path).await.map(|object| (entry, object)) }
        });
        let reads = stream::iter(reads.collect::<Vec<_>>()).buffered(N_READS);
        let read = self.wait("reading", prefix, reads.try_collect::<Vec<_>>())?;
        let mut own = Vec::new();
        for (entry, object) in read.map_err(failing("reading", prefix))? {
            let Some(object) = object else { continue };
            match Header::split(&object.bytes) {
                Ok((header, _)) if header.daemon != self.daemon => {}
                // Its session is gone already; nobody writes to it any more.
                Ok((header, _)) if header.is_deleted => self.delete(&entry.name)?,
                Ok(_) => own.push(entry),
                Err(why) => tracing::error!(name = entry.name, why, "no journal; left alone"),
            }
        }
        Ok(own)
    }

    fn peek(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        let entry = self.held().get(name).cloned();
        if let Some(entry) = entry {
            let held = entry.lock().unwrap_or_else(PoisonError::into_inner);
            if !held.is_gone {
                return Ok(Some(held.records.clone()));
            }
        }
        let Some(object) = self.read("reading", name)? else { return Ok(None) };
        match Header::split(&object.bytes) {
            Ok((header, records)) => Ok((!header.is_deleted).then(|| records.to_vec())),
            Err(why) => Err(damaged("reading", name, why)),
        }
    }

    fn claim(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        const ACTION: &str = "taking over";
        for _ in 0..MAX_CLAIMS {
            let Some(object) = self.read(ACTION, name)? else { return Ok(None) };
            let (header, records) =
                Header::split(&object.bytes).map_err(|why| damaged(ACTION, name, why))?;
            if header.is_deleted {
                return Ok(None);
            }
            let own = self.header(false);
            let bytes = own.before(records).map_err(|error| failed(ACTION, name, error.into()))?;
            match self.write(ACTION, name, &bytes, PutMode::Update(object.version), Over::Nothing) {
                Ok(version) => {
                    self.hold(name, records.to_vec(), version);
                    return Ok(Some(records.to_vec()));
                }
                // Its owner has written to it meanwhile.
                Err(error) if error.is_taken() => {}
                Err(error) => return Err(error),
            }
        }
        Err(failed(ACTION, name, io::ErrorKind::ResourceBusy.into()))
    }

    fn begin(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        const ACTION: &str = "writing";
        let object = self.header(false).before(bytes);
        let object = object.map_err(|error| failed(ACTION, name, error.into()))?;
        let version = self.write(ACTION, name, &object, PutMode::Create, Over::Nothing)?;
        self.hold(name, bytes.to_vec(), version);
        Ok(())
    }

    fn rewrite(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        self.replace("writing", name, false, |_| Ok(bytes.to_vec()))
    }

    fn remove(&self, name: &str) -> Result<(), StorageError> {
        self.replace("deleting", name, true, |_| Ok(Vec::new()))?;
        if let Err(error) = self.delete(name) {
            // A tombstone is as good as nothing; the next start of a daemon of this name clears it away.
            tracing::warn!(%error, "a journal's tombstone is left behind");
        }
        Ok(())
    }

    fn is_held(&self, name: &str) -> Result<bool, StorageError> {
        let Some(entry) = self.held().get(name).cloned() else { return Ok(false) };
        // Whoever has it now is writing, and will learn it.
        let Ok(mut held) = entry.try_lock() else { return Ok(true) };
        let found = self.read("reading", name)?;
        let is_ours = found.is_some_and(|found| {
            let header = || Header::split(&found.bytes);
            found.version.e_tag == held.version.e_tag
                || header().is_ok_and(|(header, _)| header.writer == self.writer)
        });
        if !is_ours {
            self.let_go(name, &entry, &mut held);
        }
        Ok(is_ours)
    }
}
