"""Keys: what a client shows over HTTP and Zenoh, and what it hears then."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import CONFIG, PATIENCE_S, PROGRAM, SEAM, STIFFNESS_N_M, Daemon, bar

import sutura
from sutura.bus import ZenohClient


def _key(folder: Path, tenant: str) -> str:
    command = [PROGRAM, "key", "new", "--tenant", tenant, "--role", "edit"]
    made = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return made.stdout.strip()


def test_states_reach_their_tenant_over_zenoh(tmp_path: Path) -> None:
    key, other = _key(tmp_path, "a"), _key(tmp_path, "b")
    daemon = Daemon(tmp_path)
    try:
        with sutura.Client(daemon.http, api_key=key) as client:
            session = client.create(bar(), **CONFIG, wait=True)
            session.stitch(SEAM, STIFFNESS_N_M)
            session.simulate()
            with ZenohClient(daemon.zenoh, api_key=key) as zenoh:
                remote = zenoh.session(session.id)
                assert remote.info().tenant == "a"
                with remote.states() as states:
                    assert states.next(PATIENCE_S) is not None
            with ZenohClient(daemon.zenoh, api_key=other) as zenoh:
                with pytest.raises(sutura.NotFoundError):
                    zenoh.session(session.id).info()
                assert zenoh.sessions() == []
        with pytest.raises(sutura.ConnectionFailedError):
            ZenohClient(daemon.zenoh)
    finally:
        daemon.stop()


def test_a_certificate_authority_of_one_s_own_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        sutura.Client("https://127.0.0.1:1", ca_file=tmp_path / "none.pem")
