"""A real daemon for the tests, and a small body to operate on: a bar cut in two."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sutura
from sutura.bus import ZenohClient

ROOT = Path(__file__).parents[3]
PATIENCE_S = 60.0
PROGRAM = os.environ.get("SUTURA_EXECUTABLE", str(ROOT / "target/debug/sutura"))


class Daemon:
    """A process of its own on free ports."""

    def __init__(self, folder: Path, config: Path | None = None) -> None:
        addresses = ["--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0"]
        configured = [] if config is None else ["--config", str(config)]
        self._process = subprocess.Popen(
            [PROGRAM, "serve", *addresses, "--log", "warn", *configured],
            cwd=folder,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.http = self.zenoh = ""
        for line in self._process.stdout:
            name, _, address = line.partition(" ")
            if name == "http":
                self.http = address.strip()
            elif name == "zenoh":
                self.zenoh = address.strip()
            if self.http and self.zenoh:
                break
        assert self.http and self.zenoh, "the daemon named no addresses"
        # What it goes on to print must not fill the pipe.
        self._drain = threading.Thread(target=self._process.stdout.read, daemon=True)
        self._drain.start()

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()
        self._drain.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture(scope="session")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path_factory.mktemp("daemon"))
    yield daemon
    daemon.stop()


@pytest.fixture(scope="session")
def client(daemon: Daemon) -> Iterator[sutura.Client]:
    with sutura.Client(daemon.http) as client:
        yield client


@pytest.fixture(scope="session")
def zenoh_client(daemon: Daemon) -> Iterator[ZenohClient]:
    with ZenohClient(daemon.zenoh) as client:
        yield client


CELLS = (4, 2, 2)
EDGE_M = 0.025
N_HALF = 45
STIFFNESS_N_M = 1e5
TIP = 2 * N_HALF - 1
FIXED = [row * 5 for row in range(9)]
# The nine pairs of vertices where the halves meet.
SEAM = np.array([[row * 5 + 4, N_HALF + row * 5] for row in range(9)])
CONFIG: dict[str, Any] = {
    "name": "bar",
    "material": sutura.material(5e5, 0.4, 1000.0),
    "fixed_vertices": FIXED,
    "n_modes": 8,
    "basis": {"size": 24, "n_derivative_modes": 5},
    "cubature": {"n_points": 60, "n_training_poses": 40, "tolerance": 0.02, "seed": 1},
}


def bar() -> sutura.Mesh:
    """Two halves of 4 × 2 × 2 cells of six tets, labelled 1 and 2, which meet at x = 0.1 m."""
    nx, ny, nz = CELLS
    vertices, tets, domains = [], [], []
    for half in range(2):
        first = len(vertices)
        places = [(i, j, k) for k in range(nz + 1) for j in range(ny + 1) for i in range(nx + 1)]
        vertices += [((i + half * nx) * EDGE_M, j * EDGE_M, k * EDGE_M) for i, j, k in places]
        number = {place: first + at for at, place in enumerate(places)}
        for corner in np.ndindex(nx, ny, nz):
            # Kuhn's subdivision: one tet for each order in which the three axes can be walked; odd
            # orders walk it inside out.
            for axes in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]:
                place = list(corner)
                tet = [number[tuple(place)]]
                for axis in axes:
                    place[axis] += 1
                    tet.append(number[tuple(place)])
                if axes in [(0, 2, 1), (2, 1, 0), (1, 0, 2)]:
                    tet[2], tet[3] = tet[3], tet[2]
                tets.append(tet)
                domains.append(half + 1)
    return sutura.Mesh.of(vertices, tets, domains)


@pytest.fixture
def session(client: sutura.Client) -> Iterator[sutura.Session]:
    session = client.create(bar(), **CONFIG, wait=True)
    yield session
    with contextlib.suppress(sutura.NotFoundError):
        session.delete()


def prepared(session: Any, n_pairs: int) -> None:
    """Wait until the daemon has prepared so many pairs."""
    deadline = time.monotonic() + PATIENCE_S
    while session.info().n_prepared_pairs < n_pairs:
        assert time.monotonic() < deadline, "the seams were not prepared"
        time.sleep(0.02)
