use super::*;
use std::sync::mpsc;

const FIRST: Class = 0;
const SECOND: Class = 1;

fn limits(n_waiting: usize, n_running: usize) -> ClassLimits {
    ClassLimits { name: "test", n_waiting, n_running, max_wait: None, is_patient: false }
}

fn place(class: Class, lane: Option<SessionId>) -> Place {
    lane.into_iter().fold(Place::new(class), Place::in_lane)
}

/// Waiting and running tasks of a class.
fn load(pool: &Pool, class: Class) -> (usize, usize) {
    let TaskLoad { n_waiting, n_running, .. } = pool.load()[class];
    (n_waiting, n_running)
}

fn pool(n_threads: usize, n_waiting: usize) -> Pool {
    let limits = limits(n_waiting, n_threads);
    Pool::start("test", n_threads, vec![limits, limits]).unwrap()
}

/// Occupies one worker until the returned sender is dropped or used.
fn occupy(pool: &Pool, class: Class, lane: Option<SessionId>) -> mpsc::Sender<()> {
    let (release, released) = mpsc::channel();
    let (began, begin) = mpsc::channel();
    pool.submit(place(class, lane), move |_| {
        began.send(()).unwrap();
        let _ = released.recv();
    })
    .unwrap();
    begin.recv().unwrap();
    release
}

/// Queues a task that sends `name` when it runs.
fn note(pool: &Pool, class: Class, name: u32, log: &mpsc::Sender<u32>) {
    let log = log.clone();
    pool.submit(place(class, None), move |_| log.send(name).unwrap()).unwrap();
}

#[test]
fn the_first_class_goes_first_and_each_class_in_order() {
    let pool = pool(1, 8);
    let release = occupy(&pool, SECOND, None);
    let (log, order) = mpsc::channel();
    for (class, name) in [(SECOND, 3), (SECOND, 4), (FIRST, 1), (FIRST, 2)] {
        note(&pool, class, name, &log);
    }
    drop(release);
    assert_eq!(order.iter().take(4).collect::<Vec<_>>(), [1, 2, 3, 4]);
}

#[test]
fn a_full_class_sheds_and_leaves_the_other_open() {
    let pool = pool(1, 1);
    let _release = occupy(&pool, SECOND, None);
    pool.submit(place(SECOND, None), |_| {}).unwrap();
    let refused = pool.submit(place(SECOND, None), |_| {}).err().unwrap();
    assert!(matches!(refused, StoreError::Busy { retry_after_s: 1.. }), "{refused:?}");
    pool.submit(place(FIRST, None), |_| {}).unwrap();
    assert_eq!([FIRST, SECOND].map(|class| load(&pool, class)), [(1, 0), (1, 1)]);
}

#[test]
fn a_class_leaves_threads_to_the_others() {
    let all = limits(8, 2);
    let pool = Pool::start("test", 2, vec![all, ClassLimits { n_running: 1, ..all }]).unwrap();
    let _release = occupy(&pool, SECOND, None);
    pool.submit(place(SECOND, None), |_| {}).unwrap();
    let (log, order) = mpsc::channel();
    note(&pool, FIRST, 1, &log);
    assert_eq!(order.recv(), Ok(1));
    assert_eq!(load(&pool, SECOND), (1, 1));
}

#[test]
fn one_lane_runs_one_task_at_a_time_and_does_not_hold_up_the_others() {
    let pool = pool(2, 8);
    let lane = SessionId::behind(None);
    let release = occupy(&pool, FIRST, Some(lane));
    let (log, order) = mpsc::channel();
    let later = log.clone();
    pool.submit(place(FIRST, Some(lane)), move |_| later.send(2).unwrap()).unwrap();
    note(&pool, FIRST, 1, &log);
    assert_eq!(order.recv(), Ok(1));
    assert_eq!(load(&pool, FIRST).0, 1);
    drop(release);
    assert_eq!(order.recv(), Ok(2));
}

#[test]
fn dropping_the_guard_takes_a_waiting_task_out_of_the_queue() {
    let pool = pool(1, 1);
    let _release = occupy(&pool, FIRST, None);
    let guard = pool.submit(place(FIRST, None), |_| unreachable!()).unwrap().cancel_on_drop();
    assert_eq!(load(&pool, FIRST).0, 1);
    drop(guard);
    assert_eq!(load(&pool, FIRST).0, 0);
}

#[test]
fn dropping_the_guard_tells_a_running_task() {
    let pool = pool(1, 1);
    let (began, begin) = mpsc::channel();
    let (ended, end) = mpsc::channel();
    let task = move |cancel: &CancelFlag| {
        began.send(()).unwrap();
        while !cancel.is_set() {
            std::thread::yield_now();
        }
        ended.send(()).unwrap();
    };
    let guard = pool.submit(place(FIRST, None), task).unwrap().cancel_on_drop();
    begin.recv().unwrap();
    drop(guard);
    assert_eq!(end.recv(), Ok(()));
}

#[test]
fn cancelling_a_lane_leaves_the_others_alone() {
    let pool = pool(1, 8);
    let release = occupy(&pool, FIRST, None);
    let lane = SessionId::behind(None);
    pool.submit(place(FIRST, Some(lane)), |_| unreachable!()).unwrap();
    let (log, order) = mpsc::channel();
    note(&pool, FIRST, 1, &log);
    pool.cancel_lane(lane);
    drop(release);
    assert_eq!(order.recv(), Ok(1));
}

#[test]
fn a_panic_leaves_the_worker_alive() {
    let pool = pool(1, 8);
    pool.submit(place(FIRST, None), |_| panic!("on purpose")).unwrap();
    let (log, order) = mpsc::channel();
    note(&pool, FIRST, 1, &log);
    assert_eq!(order.recv(), Ok(1));
}

#[test]
fn closing_drops_what_waits_cancels_the_named_classes_and_lets_the_rest_finish() {
    let pool = pool(2, 8);
    let release = occupy(&pool, FIRST, None);
    let (began, begin) = mpsc::channel();
    let build = move |cancel: &CancelFlag| {
        began.send(()).unwrap();
        while !cancel.is_set() {
            std::thread::yield_now();
        }
    };
    pool.submit(place(SECOND, None), build).unwrap();
    begin.recv().unwrap();
    pool.submit(place(FIRST, None), |_| unreachable!()).unwrap();
    pool.close(&[SECOND]);
    assert!(matches!(pool.submit(place(FIRST, None), |_| {}), Err(StoreError::ShuttingDown)));
    drop(release);
    assert!(pool.join(Instant::now() + Duration::from_secs(60), Duration::from_secs(60)));
}

#[test]
fn a_class_leaves_threads_to_those_before_it_together_with_those_behind_it() {
    let (one, all) = (limits(8, 1), limits(8, 2));
    let pool = Pool::start("test", 2, vec![all, one, one]).unwrap();
    let _release = occupy(&pool, SECOND + 1, None);
    let (log, order) = mpsc::channel();
    note(&pool, SECOND, 2, &log);
    note(&pool, FIRST, 1, &log);
    assert_eq!(order.recv(), Ok(1));
    assert_eq!(load(&pool, SECOND), (1, 0));
}

#[test]
fn patient_tasks_compute_on_threads_of_their_own() {
    let patient = ClassLimits { is_patient: true, ..limits(8, 1) };
    let pool = Pool::start("test", 1, vec![patient, limits(8, 1)]).unwrap();
    let (log, threads) = mpsc::channel();
    for class in [FIRST, SECOND] {
        let log = log.clone();
        let name = move || std::thread::current().name().unwrap_or_default().to_owned();
        pool.submit(place(class, None), move |_| log.send(name()).unwrap()).unwrap();
    }
    assert!(threads.recv().unwrap().starts_with("patient-"));
    assert_eq!(threads.recv().unwrap(), "test-0");
}

/// Teaches the pool that a task of `class` takes `took`.
fn teach(pool: &Pool, class: Class, took: Duration) {
    pool.shared.lock().mean_s[class] = Some(took.as_secs_f64());
}

#[test]
fn a_task_that_would_wait_too_long_is_refused_at_once() {
    let limits = ClassLimits { max_wait: Some(Duration::from_secs(60)), ..limits(8, 1) };
    let pool = Pool::start("test", 1, vec![limits]).unwrap();
    let _release = occupy(&pool, FIRST, None);
    teach(&pool, FIRST, Duration::from_secs(50));
    // Behind half a task, and behind one and a half.
    pool.submit(place(FIRST, None), |_| {}).unwrap();
    let refused = pool.submit(place(FIRST, None), |_| {}).err().unwrap();
    assert!(matches!(refused, StoreError::Busy { retry_after_s: 75 }), "{refused:?}");
}

#[tokio::test]
async fn a_task_that_has_waited_too_long_is_answered_and_never_runs() {
    let limits = ClassLimits { max_wait: Some(Duration::from_millis(20)), ..limits(8, 1) };
    let pool = Pool::start("test", 1, vec![limits]).unwrap();
    let release = occupy(&pool, FIRST, None);
    let waited = pool.run(place(FIRST, None), "a task", |_| -> Result<(), _> { unreachable!() });
    let refused = waited.await.unwrap_err();
    assert!(matches!(refused, StoreError::Busy { retry_after_s: 1.. }), "{refused:?}");
    assert_eq!(load(&pool, FIRST), (0, 1));
    drop(release);
}

#[tokio::test]
async fn a_task_that_has_begun_may_take_longer_than_it_might_have_waited() {
    let limits = ClassLimits { max_wait: Some(Duration::from_millis(20)), ..limits(8, 1) };
    let pool = Pool::start("test", 1, vec![limits]).unwrap();
    let slow = |_: &CancelFlag| {
        std::thread::sleep(Duration::from_millis(60));
        Ok(7)
    };
    assert_eq!(pool.run(place(FIRST, None), "a task", slow).await.unwrap(), 7);
}
