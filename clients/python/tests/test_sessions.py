"""Opening sessions, in every way there is, and ending them."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from conftest import CONFIG, FIXED, PATIENCE_S, SEAM, STIFFNESS_N_M, Daemon, bar

import sutura
from sutura.bus import ZenohClient


def test_the_same_body_from_arrays_files_and_meshio(
    client: sutura.Client, tmp_path: Path, session: sutura.Session
) -> None:
    mesh = bar()
    cells = [("tetra", mesh.tets.astype(np.int32)), ("triangle", mesh.tets[:3, :3].astype(np.int32))]
    labels = [mesh.domains.astype(np.int32), np.zeros(3, np.int32)]
    tagged = {"gmsh:physical": labels, "gmsh:geometrical": labels}
    grid = meshio.Mesh(mesh.vertices, cells, cell_data=tagged)
    file = tmp_path / "bar.msh"
    grid.write(file, file_format="gmsh22", binary=True)
    far = sutura.Mesh.of(mesh.vertices, mesh.tets, mesh.domains + 2**40)
    expected = session.modes(dtype="f64")
    unlabelled = (mesh.vertices, mesh.tets)
    for source, n_domains in [(grid, 2), (file, 2), (str(file), 2), (far, 2), (unlabelled, 1)]:
        other = client.create(source, **CONFIG, wait=True)
        info = other.info()
        assert (info.n_vertices, info.n_tets, info.n_domains) == (90, 192, n_domains)
        assert info.n_components == 2
        assert other.mass(dtype="f64").sum() == pytest.approx(0.5, abs=1e-12)
        np.testing.assert_allclose(other.modes(dtype="f64"), expected, atol=1e-8)
        other.delete()
    info = session.info()
    assert info.parameters is not None
    assert set(info.parameters["domain_materials"]) == {"1", "2"}


def test_a_configuration_file_with_changes(client: sutura.Client, tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps(CONFIG))
    session = client.create(bar(), config=path, name="other", n_modes=5, cubature=False)
    info = session.wait_ready(timeout_s=PATIENCE_S)
    assert (info.name, info.n_modes, info.n_cubature_points) == ("other", 5, None)
    assert info.parameters is not None and info.parameters["n_fixed_vertices"] == len(FIXED)
    session.delete()


def test_stages_are_told_and_shown(client: sutura.Client, capsys: pytest.CaptureFixture[str]) -> None:
    told: list[sutura.Event] = []
    # Another material than that of any other session: nothing is shared, everything is built.
    config = {**CONFIG, "material": sutura.material(4.1e5, 0.4)}
    session = client.create(bar(), **config)
    session.wait_ready(told.append)
    assert told[0].event == "state" and told[-1].generation == 0
    assert all(event.event in ("state", "stage", "generation") for event in told)
    config = {**CONFIG, "material": sutura.material(4.2e5, 0.4)}
    other = client.create(bar(), **config, progress=True)
    assert other.info().state == "ready"
    bars = sutura.ProgressBars()
    for progress in (0.25, 1.0):
        raw = {"event": "stage", "stage": "modes", "progress": progress}
        bars(sutura.Event(raw=raw, event="stage", stage="modes", progress=progress))
    bars.close()
    assert "100 %" in capsys.readouterr().err
    for ended in (session, other):
        ended.delete()


def test_forks_go_their_own_way(client: sutura.Client, session: sutura.Session) -> None:
    fork = session.fork("the other bar")
    assert fork.info().name == "the other bar"
    fork.stitch(SEAM, STIFFNESS_N_M)
    assert (fork.info().generation, session.info().generation) == (1, 0)
    listed = [info.id for info in client.sessions(page=1)]
    assert listed.index(session.id) < listed.index(fork.id)
    events = session.events(timeout_s=PATIENCE_S)
    assert next(events).event == "state"
    session.delete()
    assert [event.event for event in events] == ["deleted"]
    with pytest.raises(sutura.NotFoundError):
        session.info()
    fork.delete()


def test_the_network_knows_daemons_and_sessions(zenoh_client: ZenohClient, session: sutura.Session) -> None:
    assert len(zenoh_client.daemons()) == 1
    found = {info.id: info for info in zenoh_client.sessions()}
    assert found[session.id].raw == zenoh_client.session(session.id).info().raw
    with pytest.raises(sutura.NotFoundError):
        zenoh_client.session("nobody").info()


def test_refusals_name_what_is_at_fault(client: sutura.Client, session: sutura.Session) -> None:
    with pytest.raises(sutura.ImpossibleError) as refused:
        session.stitch([*SEAM[:1].tolist(), [0, 7]], STIFFNESS_N_M)
    assert refused.value.pointer == "/edits/0/stitch/pairs/1"
    assert "vertices 0 and 7" in str(refused.value)
    with pytest.raises(sutura.ConflictError):
        session.stitch(SEAM, STIFFNESS_N_M, base_generation=7)
    with pytest.raises(sutura.ProblemError) as refused:
        client.create(bar(), material=sutura.material(5e5, 0.7))
    assert refused.value.pointer == "/material/poisson_ratio"
    inverted = bar().tets.copy()
    inverted[5, :2] = inverted[5, 1::-1]
    with pytest.raises(sutura.ProblemError, match="element 6: tet 5 is inverted"):
        client.create((bar().vertices, inverted), material=sutura.material(5e5, 0.4))
    with pytest.raises(sutura.ProblemError, match="unknown field"):
        client.create(bar(), **CONFIG, config={"n_mods": 3})
    with pytest.raises(sutura.NotFoundError):
        client.session("nobody").info()
    assert session.info().generation == 0


def test_wrong_arguments_are_refused_before_they_travel(client: sutura.Client) -> None:
    mesh = bar()
    wrong: list[Any] = [
        (mesh.vertices[:, :2], mesh.tets),
        (mesh.vertices, mesh.tets.astype(float)),
        (mesh.vertices, mesh.tets + 1),
        (mesh.vertices, mesh.tets, mesh.domains[1:]),
        meshio.Mesh(mesh.vertices, [("triangle", mesh.tets[:, :3])]),
    ]
    for source in wrong:
        with pytest.raises(sutura.MismatchError):
            client.create(source, **CONFIG)
    with pytest.raises(TypeError):
        client.create(42, **CONFIG)
    with pytest.raises(ValueError):
        client.session("../sessions")
    with pytest.raises(ValueError):
        sutura.edits.stitch([[1.5, 2.0]], 1e5)
    with pytest.raises(ValueError):
        sutura.Client("ftp://127.0.0.1")
    with pytest.raises(sutura.ConnectionFailedError):
        sutura.Client("http://127.0.0.1:1")


def test_a_client_serves_many_threads(daemon: Daemon, session: sutura.Session) -> None:
    expected = session.basis()
    found: list[Any] = []
    fetch = [threading.Thread(target=lambda: found.append(session.basis())) for _ in range(8)]
    for thread in fetch:
        thread.start()
    for thread in fetch:
        thread.join()
    assert len(found) == 8 and all(np.array_equal(array, expected) for array in found)
