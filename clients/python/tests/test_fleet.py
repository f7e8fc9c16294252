"""Daemons that share an object store: whichever is asked for a session takes it over.

The store is whatever speaks S3 at the other end of ``SUTURA_OBJECT_STORE``, a program that takes
``-H HOST -p PORT``; the tests in ``.ci/run`` name moto's.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import CONFIG, PATIENCE_S, PROGRAM, SEAM, STIFFNESS_N_M, Daemon, bar

import sutura

STORE = os.environ.get("SUTURA_OBJECT_STORE")
TAKEN = "urn:sutura:problem:session-taken"
# How long a daemon that lost a session leaves it to the other one.
HAND_OVER_S = 10.0

pytestmark = pytest.mark.skipif(STORE is None, reason="SUTURA_OBJECT_STORE names no program")


class ObjectStore:
    """A bucket, in a process of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"
        assert STORE is not None
        with (folder / "store.log").open("wb") as log:
            self.process = subprocess.Popen([STORE, "-H", "127.0.0.1", "-p", str(port)], stdout=log, stderr=log)
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                request = urllib.request.Request(f"{self.url}/fleet", method="PUT")
                urllib.request.urlopen(request, timeout=PATIENCE_S).close()
                return
            except OSError:
                assert time.monotonic() < deadline, "the object store did not come up"
                time.sleep(0.1)

    def stop(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait()


class Fleet:
    """Daemons on one bucket."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self._daemons: list[Daemon] = []
        self._clients: list[sutura.Client] = []
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", "fleet")
        monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "a-secret-of-the-test")
        self.store = ObjectStore(folder)

    def start(self, name: str) -> Daemon:
        folder = self._folder / f"{name}-{len(self._daemons)}"
        folder.mkdir()
        config = folder / "sutura.toml"
        config.write_text(
            f'[object_store]\nbucket = "fleet"\nendpoint = "{self.store.url}"\n[zenoh]\ndaemon = "{name}"\n'
        )
        daemon = Daemon(folder, config=config)
        self._daemons.append(daemon)
        return daemon

    def client(self, daemon: Daemon) -> sutura.Client:
        self._clients.append(sutura.Client(daemon.http))
        return self._clients[-1]

    def session(self, daemon: Daemon, id: str) -> sutura.Session:
        return self.client(daemon).session(id)

    def stop(self) -> None:
        for client in self._clients:
            client.close()
        for daemon in self._daemons:
            daemon.signal(signal.SIGCONT)
            daemon.stop()
        self.store.stop()


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path, monkeypatch)
    yield fleet
    fleet.stop()


def test_another_daemon_serves_the_sessions_of_one_that_was_killed(fleet: Fleet) -> None:
    a, b = fleet.start("a"), fleet.start("b")
    client = fleet.client(a)
    session = client.create(bar(), **CONFIG, wait=True)
    first = session.stitch(SEAM[:5], STIFFNESS_N_M)
    second = session.stitch(SEAM[5:7], STIFFNESS_N_M)
    other = session.fork("another")
    poses = 1e-3 * np.random.default_rng(1).standard_normal((3, first.basis_size))
    values = session.evaluate(poses)
    earlier = session.evaluate(poses, generation=1)
    a.stop()

    taken = fleet.session(b, session.id)
    assert taken.info().generation == 2
    assert taken.wait_ready(timeout_s=PATIENCE_S).state == "ready"
    np.testing.assert_array_equal(taken.evaluate(poses).force, values.force)
    np.testing.assert_array_equal(taken.evaluate(poses).energy_j, values.energy_j)
    np.testing.assert_array_equal(taken.evaluate(poses, generation=1).force, earlier.force)
    third = taken.stitch(SEAM[7:], STIFFNESS_N_M)
    assert (third.generation, third.n_stitches) == (3, 9)
    assert second.n_stitches == 7

    # Started anew, it has what nobody took meanwhile, and takes the rest when it is asked for.
    a = fleet.start("a")
    assert [info.id for info in fleet.client(a).sessions()] == [other.id]
    assert fleet.session(a, other.id).wait_ready(timeout_s=PATIENCE_S).generation == 2
    assert fleet.session(a, session.id).wait_ready(timeout_s=PATIENCE_S).generation == 3
    fleet.session(a, session.id).delete()
    with pytest.raises(sutura.NotFoundError):
        fleet.session(a, session.id).info()
    # The other one had it last; it finds that it is gone.
    deadline = time.monotonic() + HAND_OVER_S + PATIENCE_S
    while True:
        try:
            fleet.session(b, session.id).unstitch()
        except sutura.NotFoundError:
            break
        except sutura.ConflictError as refused:
            assert refused.problem.type == TAKEN
        assert time.monotonic() < deadline
        time.sleep(0.2)


def test_a_daemon_that_was_stopped_for_a_while_finds_its_session_taken(fleet: Fleet) -> None:
    a, b = fleet.start("a"), fleet.start("b")
    mine = fleet.client(a).create(bar(), **CONFIG, wait=True)
    mine.stitch(SEAM[:5], STIFFNESS_N_M)
    a.signal(signal.SIGSTOP)
    theirs = fleet.session(b, mine.id)
    theirs.wait_ready(timeout_s=PATIENCE_S)
    second = theirs.stitch(SEAM[5:7], STIFFNESS_N_M)
    assert second.generation == 2
    a.signal(signal.SIGCONT)

    with pytest.raises(sutura.ConflictError) as refused:
        mine.stitch(SEAM[7:], STIFFNESS_N_M)
    assert refused.value.problem.type == TAKEN
    assert refused.value.retry_after_s == HAND_OVER_S
    assert mine.id not in [info.id for info in fleet.client(a).sessions()]
    info = theirs.info()
    assert (info.generation, info.n_stitches) == (2, 7)
    third = theirs.stitch(SEAM[7:], STIFFNESS_N_M)
    assert (third.generation, third.n_stitches) == (3, 9)


def test_a_store_that_does_not_answer_costs_nothing_that_was_acknowledged(fleet: Fleet) -> None:
    a = fleet.start("a")
    session = fleet.client(a).create(bar(), **CONFIG, wait=True)
    session.stitch(SEAM[:5], STIFFNESS_N_M)
    fleet.store.process.send_signal(signal.SIGSTOP)
    with pytest.raises(sutura.BusyError) as refused:
        session.stitch(SEAM[5:], STIFFNESS_N_M)
    assert refused.value.status == 503 and refused.value.retry_after_s is not None
    assert session.info().generation == 1
    session.evaluate(np.zeros(session.info().basis_size))
    # What was given up may still arrive now; it is not there for anybody who looks.
    fleet.store.process.send_signal(signal.SIGCONT)
    second = session.stitch(SEAM[5:7], STIFFNESS_N_M)
    assert (second.generation, second.n_stitches) == (2, 7)
    a.stop()
    b = fleet.start("b")
    info = fleet.session(b, session.id).wait_ready(timeout_s=PATIENCE_S)
    assert (info.generation, info.n_stitches) == (2, 7)


def test_a_bucket_that_is_not_there_is_told_at_the_start(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "sutura.toml"
    config.write_text(f'[object_store]\nbucket = "nowhere"\nendpoint = "{fleet.store.url}"\n')
    serve = [PROGRAM, "serve", "--config", str(config), "--http", "127.0.0.1:0"]
    ended = subprocess.run(serve, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert ended.returncode == 1 and "cannot use the object store" in ended.stderr
    assert "a-secret-of-the-test" not in ended.stderr + ended.stdout
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    ended = subprocess.run(serve, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert ended.returncode == 2 and "AWS_SECRET_ACCESS_KEY" in ended.stderr
