"""TLS at both doors, with an authority and keys of the tests' own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import CONFIG, PATIENCE_S, PROGRAM, SEAM, STIFFNESS_N_M, Daemon, bar

import sutura
from sutura.bus import ZenohClient


def _openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


def _authority(folder: Path, name: str) -> Path:
    """Make an authority; its certificate."""
    new = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    _openssl(folder, *new, "-keyout", f"{name}.key", "-out", f"{name}.pem")
    return folder / f"{name}.pem"


def _certify(folder: Path, authority: str) -> None:
    """Have an authority sign a certificate of this machine, chain.pem with key.pem."""
    request = ["req", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=sutura"]
    _openssl(folder, *request, "-keyout", "key.pem", "-out", "request.pem")
    extensions = "subjectAltName=IP:127.0.0.1,DNS:localhost\nbasicConstraints=CA:FALSE\n"
    (folder / "extensions").write_text(extensions)
    signed = ["-CA", f"{authority}.pem", "-CAkey", f"{authority}.key", "-CAcreateserial"]
    files = ["-in", "request.pem", "-out", "chain.pem", "-extfile", "extensions"]
    _openssl(folder, "x509", "-req", "-days", "2", *signed, *files)


def test_both_doors_are_entered_with_an_authority_and_a_key(tmp_path: Path) -> None:
    ours, other = _authority(tmp_path, "ours"), _authority(tmp_path, "other")
    _certify(tmp_path, "ours")
    config = tmp_path / "sutura.toml"
    config.write_text('[tls]\ncertificate = "chain.pem"\nprivate_key = "key.pem"\n')
    new_key = [PROGRAM, "key", "new", "--tenant", "a", "--role", "edit"]
    made = subprocess.run(new_key, cwd=tmp_path, check=True, capture_output=True, text=True)
    key = made.stdout.strip()
    daemon = Daemon(tmp_path, config=config)
    try:
        assert daemon.http.startswith("https://") and daemon.zenoh.startswith("tls/")
        with sutura.Client(daemon.http, api_key=key, ca_file=ours) as client:
            session = client.create(bar(), **CONFIG, wait=True)
            with ZenohClient(daemon.zenoh, api_key=key, ca_file=ours) as zenoh:
                remote = zenoh.session(session.id)
                assert remote.stitch(SEAM, STIFFNESS_N_M).generation == 1
                session.simulate()
                with remote.states() as states, session.states() as over_http:
                    assert states.next(PATIENCE_S) is not None
                    assert over_http.next(PATIENCE_S) is not None
        with pytest.raises(sutura.ConnectionFailedError):
            sutura.Client(daemon.http, api_key=key, ca_file=other)
        with pytest.raises(sutura.ConnectionFailedError):
            ZenohClient(daemon.zenoh, api_key=key, ca_file=other)
        with sutura.Client(daemon.http, ca_file=ours) as stranger:
            with pytest.raises(sutura.ProblemError) as refused:
                list(stranger.sessions())
            assert refused.value.status == 401
        with pytest.raises(sutura.ConnectionFailedError):
            ZenohClient(daemon.zenoh, ca_file=ours)
    finally:
        daemon.stop()
