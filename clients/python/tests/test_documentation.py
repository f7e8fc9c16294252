"""What the documentation shows, as a user would run it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyvista
from conftest import PATIENCE_S, ROOT, SEAM, STIFFNESS_N_M, Daemon, bar

import sutura
from sutura import plot

PACKAGE = ROOT / "clients/python"
DATA = ROOT / "tests/data"


def test_the_example_runs_and_stands_in_the_readme(daemon: Daemon, tmp_path: Path) -> None:
    example = PACKAGE / "examples/stitch.py"
    assert example.read_text().strip() in (PACKAGE / "README.md").read_text()
    film = tmp_path / "film.gif"
    arguments = [DATA / "stomach_small.msh", DATA / "stomach_small.json", film]
    run = subprocess.run(
        [sys.executable, example, *arguments],
        env={**os.environ, "SUTURA_SERVER": daemon.http},
        capture_output=True,
        text=True,
        timeout=5 * PATIENCE_S,
    )
    assert run.returncode == 0, run.stderr
    assert "before:" in run.stdout and "after:" in run.stdout
    import imageio.v3

    pictures = imageio.v3.imread(film)
    assert len(pictures) == 45
    moved = np.abs(pictures[-1].astype(int) - pictures[0]).max(axis=-1) > 32
    assert moved.mean() > 1e-3, "the body moves"


def test_a_mode_is_drawn(session: sutura.Session) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    mesh = bar()
    drawn = plot.mode(session, 0)
    assert (drawn.n_points, drawn.n_cells) == (90, 192)
    moved = np.linalg.norm(drawn.points - mesh.vertices, axis=1)
    diagonal = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    np.testing.assert_allclose(moved.max(), 0.1 * diagonal, rtol=1e-6)
    np.testing.assert_allclose(drawn.point_data["|u| (m)"], moved, atol=1e-12)
    again = sutura.Mesh.of_grid(plot.grid(mesh))
    assert (again.tets == mesh.tets).all() and (again.domains == mesh.domains).all()
    pyvista.OFF_SCREEN = True
    plotter = plot.modes(session, 4)
    picture = plotter.screenshot(return_img=True)
    assert picture.std() > 1
    plotter.close()
