use crate::Objects;
use crate::header::Header;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMode, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use rand::seq::IndexedRandom as _;
use rand::{Rng as _, SeedableRng as _};
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use sutura_store::Storage;

const NAME: &str = "sessions/a";

fn open(store: &Arc<dyn ObjectStore>, daemon: &str) -> Objects {
    Objects::open(store.clone(), "fleet/1", daemon).unwrap()
}

fn in_memory() -> Arc<dyn ObjectStore> {
    Arc::new(InMemory::new())
}

fn names(objects: &Objects, prefix: &str) -> Vec<String> {
    objects.list(prefix).unwrap().into_iter().map(|entry| entry.name).collect()
}

#[test]
fn blobs_are_put_listed_and_deleted() {
    let store = in_memory();
    let (a, b) = (open(&store, "a"), open(&store, "b"));
    assert_eq!(a.get("meshes/1").unwrap(), None);
    a.put("meshes/1", b"one").unwrap();
    a.put("meshes/2/x", b"two").unwrap();
    assert_eq!(b.get("meshes/1").unwrap().unwrap(), b"one");
    assert_eq!(names(&b, "meshes"), ["meshes/1", "meshes/2/x"]);
    assert_eq!(names(&b, "sessions"), [""; 0]);
    b.delete("meshes/1").unwrap();
    b.delete("meshes/1").unwrap();
    assert_eq!(names(&a, "meshes"), ["meshes/2/x"]);
}

#[test]
fn a_journal_is_one_daemons_until_another_takes_it_over() {
    let store = in_memory();
    let (a, b) = (open(&store, "a"), open(&store, "b"));
    a.begin(NAME, b"one").unwrap();
    a.append(NAME, 3, b" two").unwrap();
    // What a call that failed has left is cut off.
    a.append(NAME, 4, b"2").unwrap();
    assert_eq!(b.peek(NAME).unwrap().unwrap(), b"one 2");
    assert!(a.is_held(NAME).unwrap() && !b.is_held(NAME).unwrap());
    assert!(b.append(NAME, 5, b"!").unwrap_err().is_taken());

    assert_eq!(b.claim(NAME).unwrap().unwrap(), b"one 2");
    assert!(a.append(NAME, 5, b" late").unwrap_err().is_taken());
    assert!(a.rewrite(NAME, b"late").unwrap_err().is_taken());
    assert!(a.remove(NAME).unwrap_err().is_taken());
    assert!(!a.is_held(NAME).unwrap());
    b.rewrite(NAME, b"short").unwrap();
    assert_eq!(a.claim(NAME).unwrap().unwrap(), b"short");
    assert!(!b.is_held(NAME).unwrap());
    assert!(b.append(NAME, 5, b"!").unwrap_err().is_taken());
}

#[test]
fn what_is_removed_does_not_come_back_by_a_late_write() {
    let store = in_memory();
    let (a, b) = (open(&store, "a"), open(&store, "b"));
    a.begin(NAME, b"one").unwrap();
    b.claim(NAME).unwrap();
    b.remove(NAME).unwrap();
    assert!(a.append(NAME, 3, b" late").unwrap_err().is_taken());
    assert!(!a.is_held(NAME).unwrap());
    assert_eq!(names(&a, "sessions"), [""; 0]);
    assert_eq!((a.peek(NAME).unwrap(), a.claim(NAME).unwrap()), (None, None));
}

/// A process that ends between the tombstone and the end of the object leaves a session that is gone.
#[test]
fn a_tombstone_is_as_good_as_nothing_and_is_cleared_away() {
    let store = in_memory();
    let faulty = Arc::new(Faulty::over(store.clone()));
    let (a, b) = (open(&(faulty.clone() as Arc<dyn ObjectStore>), "a"), open(&store, "b"));
    a.begin(NAME, b"one").unwrap();
    faulty.deletes_nothing.store(true, Relaxed);
    a.remove(NAME).unwrap();
    assert_eq!(names(&b, "sessions"), [NAME]);
    assert_eq!((b.peek(NAME).unwrap(), b.claim(NAME).unwrap()), (None, None));
    drop(a);
    assert_eq!(open(&store, "a").own("sessions").unwrap(), []);
    assert_eq!(names(&b, "sessions"), [""; 0]);
}

#[test]
fn a_restarted_daemon_finds_what_was_its_own() {
    let store = in_memory();
    let (a, b) = (open(&store, "a"), open(&store, "b"));
    for name in ["sessions/1", "sessions/2", "sessions/3"] {
        a.begin(name, b"x").unwrap();
    }
    b.claim("sessions/2").unwrap();
    drop(a);
    let a = open(&store, "a");
    let own = |objects: &Objects| {
        let own = objects.own("sessions").unwrap();
        own.into_iter().map(|entry| entry.name).collect::<Vec<_>>()
    };
    assert_eq!(own(&a), ["sessions/1", "sessions/3"]);
    assert_eq!(own(&b), ["sessions/2"]);
    // Of another process, though of the same name: it has to be claimed first.
    assert!(a.append("sessions/1", 1, b"y").unwrap_err().is_taken());
    a.claim("sessions/1").unwrap();
    a.append("sessions/1", 1, b"y").unwrap();
}

#[test]
fn a_damaged_header_is_told_and_changed_by_nobody() {
    let store = in_memory();
    let a = open(&store, "a");
    a.put(NAME, b"no journal").unwrap();
    assert!(a.peek(NAME).unwrap_err().is_damaged());
    assert!(a.claim(NAME).unwrap_err().is_damaged());
    assert_eq!(a.own("sessions").unwrap(), []);
    assert_eq!(a.get(NAME).unwrap().unwrap(), b"no journal");
}

#[test]
fn a_store_that_ignores_conditions_is_refused() {
    let faulty = Arc::new(Faulty::over(in_memory()));
    faulty.ignores_conditions.store(true, Relaxed);
    let refused = Objects::open(faulty, "", "a").unwrap_err().to_string();
    assert!(refused.contains("If-None-Match"), "{refused}");
    // A form of a later version.
    let store = in_memory();
    open(&store, "a").put("format", b"sutura objects 9\n").unwrap();
    let refused = Objects::open(store, "fleet/1", "a").unwrap_err().to_string();
    assert!(refused.contains("objects 9"), "{refused}");
}

#[test]
fn an_unreachable_store_fails_without_changing_what_is_held() {
    let faulty = Arc::new(Faulty::over(in_memory()));
    let a = open(&(faulty.clone() as Arc<dyn ObjectStore>), "a");
    a.begin(NAME, b"one").unwrap();
    faulty.n_lost_requests.store(u32::MAX, Relaxed);
    let error = a.append(NAME, 3, b" two").unwrap_err();
    assert!(!error.is_taken() && error.to_string().contains(NAME), "{error}");
    faulty.n_lost_requests.store(0, Relaxed);
    a.append(NAME, 3, b" three").unwrap();
    assert_eq!(a.peek(NAME).unwrap().unwrap(), b"one three");
}

#[test]
fn an_answer_that_is_lost_is_found_out() {
    let faulty = Arc::new(Faulty::over(in_memory()));
    let store = faulty.clone() as Arc<dyn ObjectStore>;
    let (a, b) = (open(&store, "a"), open(&store, "b"));
    let lose = |n| faulty.n_lost_answers.store(n, Relaxed);
    lose(1);
    a.begin(NAME, b"0").unwrap();
    lose(1);
    a.append(NAME, 1, b"1").unwrap();
    // All of them: it failed, as far as anybody knows, and does not stand in the way of the next.
    lose(u32::MAX);
    assert!(!a.append(NAME, 2, b"?").unwrap_err().is_taken());
    lose(0);
    assert!(a.is_held(NAME).unwrap());
    a.append(NAME, 2, b"2").unwrap();
    lose(1);
    assert_eq!(b.claim(NAME).unwrap().unwrap(), b"012");
    // Now it is another's who stands in the way.
    assert!(a.append(NAME, 3, b"3").unwrap_err().is_taken());
    lose(1);
    b.remove(NAME).unwrap();
    assert_eq!(a.claim(NAME).unwrap(), None);
}

/// Daemons that write, shorten, take over and lose requests and answers all at the same time. Whatever one of
/// them was told it had written is there in the end, once, and in order.
#[test]
fn nothing_acknowledged_is_lost_among_daemons_that_race() {
    for seed in 0..12 {
        let memory = in_memory();
        let acknowledged = Mutex::new(Vec::new());
        let first = open(&memory, "first");
        first.begin(NAME, b"").unwrap();
        drop(first);
        std::thread::scope(|scope| {
            for daemon in 0..3_u32 {
                let (memory, acknowledged) = (&memory, &acknowledged);
                scope.spawn(move || {
                    let mut random =
                        rand_chacha::ChaCha8Rng::seed_from_u64(seed * 100 + u64::from(daemon));
                    let faulty = Arc::new(Faulty::over(memory.clone()));
                    let objects =
                        open(&(faulty.clone() as Arc<dyn ObjectStore>), &daemon.to_string());
                    let mut held: Option<Vec<u8>> = None;
                    for n in 0..40_u32 {
                        match [0, 0, 0, 1, 2].choose(&mut random) {
                            Some(1) => {
                                faulty.n_lost_answers.store(random.random_range(0..6), Relaxed)
                            }
                            Some(2) => {
                                faulty.n_lost_requests.store(random.random_range(0..6), Relaxed)
                            }
                            _ => {}
                        }
                        let Some(records) = &mut held else {
                            held = objects.claim(NAME).ok().flatten();
                            continue;
                        };
                        let entry = (daemon * 1000 + n).to_le_bytes();
                        let written = match n % 5 {
                            0 => {
                                let all = [&records[..], &entry].concat();
                                objects.rewrite(NAME, &all)
                            }
                            _ => objects.append(NAME, records.len() as u64, &entry),
                        };
                        match written {
                            Ok(()) => {
                                records.extend(entry);
                                let mut all =
                                    acknowledged.lock().unwrap_or_else(PoisonError::into_inner);
                                all.push(entry);
                            }
                            Err(error) if error.is_taken() => held = None,
                            Err(_) => {}
                        }
                    }
                });
            }
        });
        let last = open(&memory, "last").claim(NAME).unwrap().unwrap();
        let (entries, rest) = last.as_chunks::<4>();
        assert!(rest.is_empty());
        let acknowledged = acknowledged.into_inner().unwrap();
        assert!(!acknowledged.is_empty());
        for entry in &acknowledged {
            assert_eq!(entries.iter().filter(|found| *found == entry).count(), 1, "seed {seed}");
        }
        for daemon in 0..3 {
            let of = |entries: &[[u8; 4]]| -> Vec<u32> {
                let numbers = entries.iter().map(|entry| u32::from_le_bytes(*entry));
                numbers.filter(|number| number / 1000 == daemon).collect()
            };
            assert!(of(entries).is_sorted() && of(&acknowledged).is_sorted(), "seed {seed}");
        }
    }
}

/// No two objects under a name have equal bytes.
#[test]
fn every_write_is_another_one() {
    let store = in_memory();
    let a = open(&store, "a");
    a.begin(NAME, b"same").unwrap();
    let first = a.get(NAME).unwrap().unwrap();
    a.rewrite(NAME, b"same").unwrap();
    let second = a.get(NAME).unwrap().unwrap();
    assert_ne!(first, second);
    assert_eq!(Header::split(&first).unwrap().1, Header::split(&second).unwrap().1);
}

/// A store in front of another one, with a network that loses things between them.
struct Faulty {
    store: Arc<dyn ObjectStore>,
    /// The next so many puts do not arrive.
    n_lost_requests: AtomicU32,
    /// The next so many puts arrive, but their answers do not.
    n_lost_answers: AtomicU32,
    ignores_conditions: AtomicBool,
    deletes_nothing: AtomicBool,
}

impl Faulty {
    fn over(store: Arc<dyn ObjectStore>) -> Faulty {
        Faulty {
            store,
            n_lost_requests: AtomicU32::new(0),
            n_lost_answers: AtomicU32::new(0),
            ignores_conditions: AtomicBool::new(false),
            deletes_nothing: AtomicBool::new(false),
        }
    }
}

/// Counts down.
fn takes_one(of: &AtomicU32) -> bool {
    of.fetch_update(Relaxed, Relaxed, |n| n.checked_sub(1)).is_ok()
}

fn lost() -> Error {
    Error::Generic { store: "faulty", source: "the connection broke".into() }
}

impl fmt::Debug for Faulty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Faulty")
    }
}

impl fmt::Display for Faulty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Faulty")
    }
}

#[async_trait::async_trait]
impl ObjectStore for Faulty {
    async fn put_opts(
        &self,
        location: &Path,
        payload: PutPayload,
        mut options: PutOptions,
    ) -> Result<PutResult> {
        if self.ignores_conditions.load(Relaxed) {
            options.mode = PutMode::Overwrite;
        }
        if takes_one(&self.n_lost_requests) {
            return Err(lost());
        }
        let answer = self.store.put_opts(location, payload, options).await;
        if takes_one(&self.n_lost_answers) { Err(lost()) } else { answer }
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.store.put_multipart_opts(location, options).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.store.get_opts(location, options).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        if self.deletes_nothing.load(Relaxed) {
            return Box::pin(futures_util::stream::empty());
        }
        self.store.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.store.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.store.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.store.copy_opts(from, to, options).await
    }
}
