//! Disks that are full, cannot be written to, or hold what nobody wrote: a real file system of a few
//! megabytes, which the daemon has to itself.

use crate::bodies::{bar, config, ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::evaluate::{Coordinates, EvaluateRequest};
use sutura_client::proto::session::SessionConfig;
use sutura_client::{Error, Generation, Session};

/// Room for a few meshes and journals.
const DISK_SIZE: &str = "1m";

/// A small file system in a mount namespace of its own, there as long as this is.
struct Disk {
    keeper: Child,
    mount_point: PathBuf,
    _scratch: tempfile::TempDir,
}

impl Disk {
    /// `None` where this system lets nobody mount one: then the log of the tests says that something was left
    /// out.
    fn mount(test: &str) -> Option<Disk> {
        let scratch = tempfile::tempdir().unwrap();
        let mount_point = scratch.path().join("disk");
        fs::create_dir(&mount_point).unwrap();
        let mount = format!(
            "mount -t tmpfs -o size={DISK_SIZE} none '{0}' && touch '{0}/ready' && exec sleep 600",
            mount_point.display()
        );
        let keeper = Command::new("unshare")
            .args(["--mount", "--", "sh", "-c", &mount])
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let mut disk = match keeper {
            Ok(keeper) => Disk { keeper, mount_point, _scratch: scratch },
            Err(error) => return left_out(test, &error.to_string()),
        };
        let begun = Instant::now();
        while !disk.seen_from_here(Path::new("ready")).exists() {
            if disk.keeper.try_wait().unwrap().is_some() {
                return left_out(test, "no file system may be mounted here");
            }
            assert!(begun.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(10));
        }
        Some(disk)
    }

    /// A path on the disk, as processes outside of its namespace reach it.
    fn seen_from_here(&self, path: &Path) -> PathBuf {
        let mount_point = self.mount_point.strip_prefix("/").unwrap();
        PathBuf::from(format!("/proc/{}/root", self.keeper.id())).join(mount_point).join(path)
    }

    fn inside(&self, program: &str) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--mount", "--target", &self.keeper.id().to_string(), "--", program]);
        command
    }

    /// A daemon whose data directory is on the disk.
    fn daemon(&self) -> Daemon {
        let executable = self.inside(env!("CARGO_BIN_EXE_sutura"));
        Daemon::start_as(executable, &self.mount_point.join("data"), &[])
    }

    fn remount(&self, mode: &str) {
        let mut mount = self.inside("mount");
        mount.args(["-o", &format!("remount,{mode}")]).arg(&self.mount_point);
        assert!(mount.status().unwrap().success());
    }

    /// Leaves no byte of room.
    fn fill(&self) -> PathBuf {
        let path = self.seen_from_here(Path::new("ballast"));
        let mut file = fs::File::options().create(true).append(true).open(&path).unwrap();
        while file.write_all(&[1; 4096]).is_ok() {}
        path
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = self.keeper.kill();
        let _ = self.keeper.wait();
    }
}

fn left_out(test: &str, why: &str) -> Option<Disk> {
    // Past the capture of a test's output.
    let mut log = std::io::stderr();
    writeln!(log, "LEFT OUT: {test}: {why}").unwrap();
    None
}

fn status<T>(result: Result<T, Error>) -> Option<u16> {
    result.err().unwrap().status()
}

/// What the current generation makes of a pose, to the bit.
async fn evaluated(session: &Session) -> (u64, Vec<u8>) {
    let info = session.wait_ready(|_| {}).await.unwrap();
    let q = (0..info.basis_size).map(|i| 1e-3 * i as f64).collect();
    let request = EvaluateRequest { q: Coordinates::Single(q), exact: false };
    let reply = session.evaluate(Generation::Current, &request).await.unwrap();
    (info.generation, serde_json::to_vec(&reply).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_changes_and_serves_the_rest() {
    let Some(disk) = Disk::mount("a_full_disk_refuses_changes_and_serves_the_rest") else { return };
    let daemon = disk.daemon();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam()[..2])).await.unwrap();
    let before = evaluated(&session).await;
    assert_eq!(before.0, 1);
    let bodies = || fs::read_dir(disk.seen_from_here(Path::new("data/bodies")));
    let n_bodies = || bodies().map_or(0, |bodies| bodies.count());
    let begun = Instant::now();
    while n_bodies() < 3 {
        assert!(begun.elapsed() < PATIENCE, "no bodies are kept");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }

    let ballast = disk.fill();
    // Kept bodies make room, and a journal's last page may have some for a record or two; none that was
    // acknowledged is lost.
    let mut n_kept = 0;
    let refused = loop {
        disk.fill();
        let stiffness_n_m = 1e4 + n_kept as f64;
        let edit = Edit::SetStiffness { stitch_ids: vec![0], stiffness_n_m };
        match session.edit(&EditRequest::new(vec![edit])).await {
            Ok(_) => n_kept += 1,
            Err(error) => break error,
        }
    };
    assert_eq!(refused.status(), Some(507), "{refused}");
    assert_eq!(n_bodies(), 0);
    let kept = evaluated(&session).await;
    assert_eq!(kept.0, 1 + n_kept as u64);
    let client = daemon.client().await;
    // Another mesh needs room of its own.
    let mut other = SessionConfig { mesh: Some(bar()), ..config() };
    other.mesh.as_mut().unwrap().vertices.iter_mut().for_each(|x| x[0] *= 1.5);
    assert_eq!(status(client.create(&other).await), Some(507));
    assert_eq!(status(session.fork(None).await), Some(507));
    assert_eq!(client.list(None, 10).await.unwrap().sessions.len(), 1);
    daemon.kill();
    // A start needs no room.
    let daemon = disk.daemon();
    let session = daemon.client().await.session(session.id()).unwrap();
    assert!(evaluated(&session).await == kept);
    fs::remove_file(ballast).unwrap();
    session.edit(&stitch(&seam()[5..6])).await.unwrap();
    let after = evaluated(&session).await;
    assert_eq!(after.0, kept.0 + 1);
    daemon.kill();
    let daemon = disk.daemon();
    let session = daemon.client().await.session(session.id()).unwrap();
    assert!(evaluated(&session).await == after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_turns_read_only_refuses_changes_and_the_next_start() {
    let test = "a_disk_that_turns_read_only_refuses_changes_and_the_next_start";
    let Some(disk) = Disk::mount(test) else { return };
    let daemon = disk.daemon();
    let session = ready_bar(&daemon).await;
    let before = evaluated(&session).await;
    // The daemon holds its lock open, as it would when a disk fails under it.
    disk.inside("mount")
        .arg("--bind")
        .args([&disk.mount_point, &disk.mount_point])
        .status()
        .unwrap();
    disk.remount("ro,bind");
    assert_eq!(status(session.edit(&stitch(&seam()[..1])).await), Some(503));
    assert!(evaluated(&session).await == before);
    assert_eq!(status(session.delete().await), Some(503));
    daemon.kill();

    let refused = disk
        .inside(env!("CARGO_BIN_EXE_sutura"))
        .args(["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0", "--data"])
        .arg(disk.mount_point.join("data"))
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(1));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains("data directory") && said.contains("Read-only"), "{said}");
    disk.remount("rw,bind");
    let daemon = disk.daemon();
    let session = daemon.client().await.session(session.id()).unwrap();
    assert!(evaluated(&session).await == before);
}

#[tokio::test(flavor = "multi_thread")]
async fn files_from_the_future_and_from_nobody_change_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let daemon = Daemon::start_on(folder);
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam()[..2])).await.unwrap();
    let before = evaluated(&session).await;
    let second = ready_bar(&daemon).await;
    assert!(daemon.terminate().success());

    // The clock was set back by a year after this was written; somebody else left files.
    let journals = folder.join("sessions");
    let later = std::time::SystemTime::now() + Duration::from_secs(365 * 24 * 3600);
    for entry in fs::read_dir(&journals).unwrap() {
        let file = fs::File::options().write(true).open(entry.unwrap().path()).unwrap();
        file.set_modified(later).unwrap();
    }
    // A session that was opened in that future.
    let future = "ffffffffffff7bbb8ccc0123456789ab";
    fs::copy(journals.join(second.id()), journals.join(future)).unwrap();
    fs::write(journals.join("notes.txt"), "not a journal").unwrap();
    fs::write(folder.join("sessions/half.tmp"), "half").unwrap();
    fs::write(folder.join("meshes/readme"), "not a mesh").unwrap();

    let daemon = Daemon::start_on(folder);
    let client = daemon.client().await;
    let session = client.session(session.id()).unwrap();
    assert!(evaluated(&session).await == before);
    session.edit(&stitch(&seam()[2..3])).await.unwrap();
    let after = evaluated(&session).await;
    // Sessions are listed in the order in which they were opened, whatever the clock said.
    let third = ready_bar(&daemon).await;
    let listed = client.list(None, 10).await.unwrap().sessions;
    let ids: Vec<&str> = listed.iter().map(|info| &*info.id).collect();
    assert_eq!(ids, [session.id(), second.id(), future, third.id()]);
    let page = client.list(Some(future), 10).await.unwrap().sessions;
    assert_eq!(page.iter().map(|info| &*info.id).collect::<Vec<_>>(), [third.id()]);
    assert!(daemon.terminate().success());
    assert_eq!(fs::read_to_string(journals.join("notes.txt")).unwrap(), "not a journal");
    let daemon = Daemon::start_on(folder);
    assert!(evaluated(&daemon.client().await.session(session.id()).unwrap()).await == after);
}
