"""The executable's own commands, with their files read by the tools that they are for."""

from __future__ import annotations

import json
import struct
import subprocess
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import pyvista
from conftest import CONFIG, PROGRAM, SEAM, STIFFNESS_N_M, TIP, Daemon, bar

import sutura

SMALL = {
    "material": sutura.material(5e5, 0.4),
    "n_modes": 4,
    "basis": {"size": 6, "n_derivative_modes": 2},
}
FORMATS = Path(__file__).parents[3] / "tests/data/formats"


def run(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    command = [PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("prepared")
    (folder / "config.json").write_text(json.dumps(CONFIG))
    mesh = bar().to_msh()
    assert mesh is not None
    (folder / "bar.msh").write_bytes(mesh)
    done = run(
        "prepare", folder / "bar.msh", "--config", folder / "config.json",
        "--out", folder / "out", "--pictures", "2", "--json",
    )  # fmt: skip
    return folder / "out", json.loads(done.stdout)


def test_what_is_prepared_without_a_daemon_is_what_a_daemon_prepares(
    prepared: tuple[Path, dict[str, Any]], session: sutura.Session
) -> None:
    folder, summary = prepared
    assert summary["frequencies_hz"] == session.info().frequencies_hz.tolist()
    assert {Path(file["path"]).name for file in summary["files"]} == {path.name for path in folder.iterdir()}
    for name in ("positions", "mass", "modes", "basis"):
        array = np.load(folder / f"{name}.npy")
        served = session.frame(name, dtype="f64")[name]
        assert array.tobytes() == served.tobytes(), name
    np.testing.assert_array_equal(np.load(folder / "tets.npy"), bar().tets)


def test_paraview_s_and_vega_s_files_hold_the_modes(prepared: tuple[Path, dict[str, Any]]) -> None:
    folder, summary = prepared
    modes, basis = np.load(folder / "modes.npy"), np.load(folder / "basis.npy")
    name = f"mode 2 ({summary['frequencies_hz'][1]:.4f} Hz)"
    for grid in (pyvista.read(folder / "modes.vtu"), meshio.read(folder / "modes.vtu")):
        vectors = grid.point_data[name]
        np.testing.assert_array_equal(vectors, modes[1])
        mesh = sutura.Mesh.of_grid(grid)
        np.testing.assert_array_equal(mesh.tets, bar().tets)
        np.testing.assert_array_equal(mesh.domains, bar().domains)
    for file, columns in [("modes.Ulin", modes), ("basis.U", basis)]:
        data = (folder / file).read_bytes()
        n_rows, n_columns = struct.unpack_from("<2i", data)
        matrix = np.frombuffer(data, "<f8", offset=8).reshape(n_columns, n_rows)
        np.testing.assert_array_equal(matrix, columns.reshape(len(columns), -1))


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    n_text, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    n_binary, kind = struct.unpack_from("<I4s", data, 20 + n_text)
    assert kind == b"BIN\0" and 28 + n_text + n_binary == len(data)
    return json.loads(data[20 : 20 + n_text]), data[28 + n_text :]


def accessor(document: dict[str, Any], binary: bytes, index: int) -> np.ndarray:
    found = document["accessors"][index]
    view = document["bufferViews"][found["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[found["type"]]
    dtype = {5125: "<u4", 5126: "<f4"}[found["componentType"]]
    values = np.frombuffer(binary, dtype, found["count"] * width, view["byteOffset"])
    assert values.nbytes == view["byteLength"]
    shaped = values.reshape(-1, width)
    if "min" in found:
        np.testing.assert_array_equal(shaped.min(0), np.float32(found["min"]))
        np.testing.assert_array_equal(shaped.max(0), np.float32(found["max"]))
    return shaped


def surface_vertices(positions: np.ndarray) -> np.ndarray:
    """The mesh's vertices that the surface's positions are; those of the seam come twice."""
    vertices = bar().vertices.astype(np.float32)
    used = np.unique([corner for face in boundary() for corner in face])
    np.testing.assert_array_equal(positions, vertices[used])
    return used


def boundary() -> list[tuple[int, ...]]:
    counts: dict[tuple[int, ...], int] = {}
    for tet in bar().tets.tolist():
        for left_out in range(4):
            face = tuple(sorted(tet[:left_out] + tet[left_out + 1 :]))
            counts[face] = counts.get(face, 0) + 1
    return [face for face, count in counts.items() if count == 1]


def test_gltf_s_morph_targets_are_the_modes(prepared: tuple[Path, dict[str, Any]]) -> None:
    folder, summary = prepared
    document, binary = read_glb(folder / "modes.glb")
    (mesh,) = document["meshes"]
    (primitive,) = mesh["primitives"]
    positions = accessor(document, binary, primitive["attributes"]["POSITION"])
    used = surface_vertices(positions)
    indices = accessor(document, binary, primitive["indices"]).reshape(-1, 3)
    assert len(indices) == len(boundary())
    corners = positions[indices]
    # Outwards: the divergence theorem gives the volume.
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(2 * 0.1 * 0.05 * 0.05, rel=1e-4)
    modes = np.load(folder / "modes.npy")
    assert len(primitive["targets"]) == len(modes) == len(document["animations"])
    for target, mode in zip(primitive["targets"], modes, strict=True):
        offsets = accessor(document, binary, target["POSITION"])
        scale = 0.1 * np.linalg.norm([0.2, 0.05, 0.05]) / np.linalg.norm(mode, axis=1).max()
        np.testing.assert_allclose(offsets, scale * mode[used], rtol=1e-5, atol=1e-8)
    swing = document["animations"][1]["samplers"][0]
    times = accessor(document, binary, swing["input"])
    assert times[-1] == pytest.approx(1 / summary["frequencies_hz"][1], rel=1e-5)
    weights = accessor(document, binary, swing["output"]).reshape(len(times), len(modes))
    assert np.abs(weights[:, 1]).max() == pytest.approx(1, abs=1e-6) and not weights[:, 0].any()


def test_pictures_show_the_modes(prepared: tuple[Path, dict[str, Any]]) -> None:
    import imageio.v3

    folder, _ = prepared
    pictures = [imageio.v3.imread(folder / f"mode_0{i}.png").astype(int) for i in (1, 2)]
    assert all(picture.std() > 5 for picture in pictures)
    assert np.abs(pictures[0] - pictures[1]).max() > 64
    assert not (folder / "mode_03.png").exists()


def test_motion_is_recorded(daemon: Daemon, session: sutura.Session, tmp_path: Path) -> None:
    generation = session.stitch(SEAM, STIFFNESS_N_M).generation
    arguments = ["export", session.id, "--server", daemon.http, "--json"]
    refused = run(*arguments, "--out", tmp_path, "--record", "0.1", code=2)
    assert "simulation" in refused.stderr
    session.simulate(dt_s=0.002, publish_hz=100.0)
    formats = ["--formats", "vtu,glb,npy", "--record", "0.2"]
    summary = json.loads(run(*arguments, "--out", tmp_path / "out", *formats).stdout)
    assert summary["generation"] == generation and summary["n_states"] >= 5
    folder = tmp_path / "out"
    collection = pyvista.get_reader(folder / "motion.pvd")
    assert collection.number_time_points == summary["n_states"]
    collection.set_active_time_point(summary["n_states"] - 1)
    (last,) = collection.read()
    displacement = np.asarray(last.point_data["displacement"])
    np.testing.assert_allclose(last.points - displacement, bar().vertices, atol=1e-12)
    # u = U q with the weights of the last key, at the surface.
    document, binary = read_glb(folder / "motion.glb")
    (animation,) = document["animations"]
    by_path = {
        channel["target"]["path"]: animation["samplers"][channel["sampler"]]
        for channel in animation["channels"]
    }
    weights = accessor(document, binary, by_path["weights"]["output"])
    basis = np.load(folder / "basis.npy")
    q = weights.reshape(-1, len(basis))
    assert len(q) == summary["n_states"]
    np.testing.assert_allclose(sutura.reconstruct(basis, q[-1]), displacement, atol=1e-6)
    assert np.abs(displacement[TIP]).max() > 1e-4, "the tip sags"
    np.testing.assert_array_equal(accessor(document, binary, by_path["rotation"]["output"])[-1], [0, 0, 0, 1])


def test_bad_input_is_located_and_told_by_the_exit_code(tmp_path: Path) -> None:
    config = tmp_path / "config.json"
    config.write_text(json.dumps(CONFIG))
    broken = tmp_path / "broken.vtk"
    text = (FORMATS / "two_boxes_v42_ascii.vtk").read_text()
    broken.write_text(text.replace("POINTS 12", "POINTS 1e2"))
    out = ["--config", config, "--out", tmp_path / "out"]
    done = run("prepare", broken, *out, code=2)
    assert "broken.vtk" in done.stderr and "line 5" in done.stderr
    done = run("prepare", FORMATS / "two_boxes_ascii.vtu", *out, code=2)
    assert "config.json" in done.stderr and "/fixed_vertices" in done.stderr
    done = run("prepare", tmp_path / "absent.msh", *out, code=2)
    assert "absent.msh" in done.stderr
    config.write_text('{"n_modes": 3}')
    assert "/material" in run("prepare", FORMATS / "two_boxes.node", *out, code=2).stderr
    config.write_text(json.dumps(SMALL))
    (tmp_path / "file").touch()
    blocked = ["--config", config, "--out", tmp_path / "file" / "out"]
    assert "out" in run("prepare", FORMATS / "two_boxes.ele", *blocked, code=1).stderr
    assert not (tmp_path / "out").exists()
    assert "--out" in run("prepare", broken, "--config", config, code=2).stderr


@pytest.mark.parametrize(
    "name", sorted(path.name for path in FORMATS.glob("two_boxes*") if path.suffix != ".ele")
)
def test_meshes_of_every_format_are_taken(client: sutura.Client, name: str) -> None:
    config = {**SMALL, "cubature": None}
    session = client.create(FORMATS / name, config=config, wait=True)
    info = session.info()
    assert (info.n_vertices, info.n_tets, info.n_domains) == (12, 12, 2)
    session.delete()


def test_half_a_mesh_is_refused(client: sutura.Client, tmp_path: Path) -> None:
    config = {"material": sutura.material(5e5, 0.4)}
    with pytest.raises(FileNotFoundError):
        (tmp_path / "a.node").write_bytes((FORMATS / "two_boxes.node").read_bytes())
        client.create(tmp_path / "a.node", config=config)
    unknown = tmp_path / "a.stl"
    unknown.write_bytes(b"solid a\nendsolid a\n")
    with pytest.raises(sutura.ProblemError) as refused:
        client.create(unknown, config=config)
    assert (refused.value.status, refused.value.pointer) == (415, "/mesh")


def test_the_doctor_looks_at_ports(daemon: Daemon, tmp_path: Path) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        config = tmp_path / "sutura.toml"
        free = '[http]\nlisten = "127.0.0.1:{}"\n[zenoh]\nlisten = "tcp/127.0.0.1:0"\n'
        config.write_text(free.format(port) + f'[data]\npath = "{tmp_path / "kept"}"\n')
        done = run("doctor", "--config", config, "--json", code=1)
        checks = {check["name"]: check for check in json.loads(done.stdout)}
        assert checks["http"]["outcome"] == "failed" and "advice" in checks["http"]
        assert checks["zenoh"]["outcome"] == "ok"
        assert checks["data"]["outcome"] == "ok" and not (tmp_path / "kept").exists()
    config.write_text(free.format(daemon.http.rsplit(":", 1)[1].strip("/")))
    checks = {c["name"]: c for c in json.loads(run("doctor", "--config", config, "--json").stdout)}
    assert "answers" in checks["daemon"]["found"] and checks["http"]["outcome"] == "ok"
    assert "\x1b" not in run("doctor", "--config", config).stdout, "colour only on a terminal"
    config.write_text("[http]\nlisen = 1\n")
    assert "lisen" in run("doctor", "--config", config, code=2).stderr


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    for arguments in ("completions zsh", "doctor", "doctor --json"):
        script = f"set -o pipefail; {PROGRAM} {arguments} | true"
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, ""), arguments


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completions_know_every_command(shell: str) -> None:
    script = run("completions", shell).stdout
    assert all(name in script for name in ("serve", "prepare", "export", "doctor", "formats"))
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)
