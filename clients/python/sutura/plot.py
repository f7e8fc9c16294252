"""Pictures and films of bodies with PyVista (``pip install sutura[plot]``)."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from types import TracebackType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pyvista
from typing_extensions import Self

from .arrays import Arrays, Generation
from .errors import MismatchError
from .frames import FloatArray
from .mesh import Mesh, MeshSource, load

_TETRA = 10
# A mode is shown with its largest displacement at this fraction of the body's diagonal.
_SHOWN_FRACTION = 0.1
_VIEWS: Mapping[str, Literal["yx", "xy", "xz"]] = {"x": "yx", "y": "xy", "z": "xz"}


def grid(mesh: MeshSource, displacement: npt.ArrayLike | None = None) -> Any:
    """Make a PyVista grid of a body: domains as cell data, |u| in m as point data.

    ``displacement`` is (n_vertices, 3); files are read with meshio.
    """
    body = as_mesh(mesh)
    cells = np.insert(body.tets.astype(np.int64), 0, 4, axis=1).ravel()
    types = np.full(len(body.tets), _TETRA, np.uint8)
    made = pyvista.UnstructuredGrid(cells, types, body.vertices.copy())
    made.cell_data["domain"] = body.domains
    if displacement is not None:
        displace(made, body, displacement)
    return made


def as_mesh(source: MeshSource) -> Mesh:
    """Make a Mesh of whatever ``Client.create`` takes."""
    loaded = load(source)
    return loaded if isinstance(loaded, Mesh) else Mesh.read(loaded)


def displace(shown: Any, mesh: Mesh, displacement: npt.ArrayLike) -> None:
    """Move the points of a grid of ``mesh``."""
    u = np.asarray(displacement, dtype=np.float64)
    if u.shape != mesh.vertices.shape:
        raise MismatchError(f"displacements {u.shape} for vertices {mesh.vertices.shape}")
    shown.points = mesh.vertices + u
    shown.point_data["|u| (m)"] = np.linalg.norm(u, axis=1)


def mode(session: Arrays, mesh: MeshSource, index: int, generation: Generation = "current") -> Any:
    """Make a grid of one linear mode, scaled so that it can be seen."""
    body = as_mesh(mesh)
    shape = session.modes(generation)[index].astype(np.float64)
    diagonal = float(np.linalg.norm(np.ptp(body.vertices, axis=0)))
    largest = float(np.linalg.norm(shape, axis=1).max())
    return grid(body, shape * (_SHOWN_FRACTION * diagonal / largest))


def modes(
    session: Arrays, mesh: MeshSource, n_modes: int = 6, generation: Generation = "current"
) -> Any:
    """Make a plotter that shows the lowest modes side by side: ``show()`` it."""
    body = as_mesh(mesh)
    n_columns = min(3, n_modes)
    plotter = pyvista.Plotter(shape=(-(-n_modes // n_columns), n_columns))
    for index in range(n_modes):
        plotter.subplot(*divmod(index, n_columns))
        plotter.add_mesh(mode(session, body, index, generation), show_scalar_bar=False)
        plotter.add_text(f"mode {index + 1}", font_size=9)
    plotter.link_views()
    return plotter


class Film:
    """A film of a moving body: a .gif or .mp4 (which needs imageio). A context manager."""

    def __init__(
        self,
        path: str | PathLike[str],
        mesh: MeshSource,
        fps: int = 30,
        size: tuple[int, int] = (640, 480),
        up: Literal["x", "y", "z"] = "y",
    ) -> None:
        """Begin the film at ``path``, seen along an axis, ``up`` upwards."""
        self._mesh = as_mesh(mesh)
        self._grid = grid(self._mesh, np.zeros_like(self._mesh.vertices))
        self._plotter = pyvista.Plotter(off_screen=True, window_size=list(size))
        self._plotter.add_mesh(self._grid, color="lightcoral", show_edges=True)
        self._plotter.camera_position = _VIEWS[up]
        self.n_frames = 0
        if str(path).endswith(".gif"):
            self._plotter.open_gif(str(path), fps=fps)
        else:
            self._plotter.open_movie(str(path), framerate=fps)

    def add(self, displacement: FloatArray) -> None:
        """Add a picture of the body at ``displacement``, (n_vertices, 3) in m."""
        displace(self._grid, self._mesh, displacement)
        self._plotter.write_frame()
        self.n_frames += 1

    def close(self) -> None:
        """End the film."""
        self._plotter.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
