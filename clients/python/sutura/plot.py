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


def grid(body: MeshSource | Arrays, displacement: npt.ArrayLike | None = None) -> Any:
    """Make a PyVista grid of a body: domains as cell data, |u| in m as point data.

    ``body`` is a session or what ``Client.create`` takes, ``displacement`` (n_vertices, 3).
    """
    mesh = as_mesh(body)
    cells = np.insert(mesh.tets.astype(np.int64), 0, 4, axis=1).ravel()
    types = np.full(len(mesh.tets), _TETRA, np.uint8)
    made = pyvista.UnstructuredGrid(cells, types, mesh.vertices.copy())
    made.cell_data["domain"] = mesh.domains
    if displacement is not None:
        displace(made, mesh, displacement)
    return made


def as_mesh(body: MeshSource | Arrays) -> Mesh:
    """Make a Mesh of a session, or of whatever ``Client.create`` takes (files with meshio)."""
    if isinstance(body, Arrays):
        return body.mesh()
    loaded = load(body)
    return loaded if isinstance(loaded, Mesh) else Mesh.read(loaded)


def displace(shown: Any, mesh: Mesh, displacement: npt.ArrayLike) -> None:
    """Move the points of a grid of ``mesh``."""
    u = np.asarray(displacement, dtype=np.float64)
    if u.shape != mesh.vertices.shape:
        raise MismatchError(f"displacements {u.shape} for vertices {mesh.vertices.shape}")
    shown.points = mesh.vertices + u
    shown.point_data["|u| (m)"] = np.linalg.norm(u, axis=1)


def mode(session: Arrays, index: int, generation: Generation = "current") -> Any:
    """Make a grid of one linear mode, scaled so that it can be seen."""
    return _mode(session.mesh(generation), session.modes(generation)[index])


def _mode(mesh: Mesh, shape: FloatArray) -> Any:
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    largest = float(np.linalg.norm(shape, axis=1).max())
    return grid(mesh, shape * (_SHOWN_FRACTION * diagonal / largest))


def modes(session: Arrays, n_modes: int = 6, generation: Generation = "current") -> Any:
    """Make a plotter that shows the lowest modes side by side: ``show()`` it."""
    mesh, shapes = session.mesh(generation), session.modes(generation)[:n_modes]
    n_columns = min(3, len(shapes))
    plotter = pyvista.Plotter(shape=(-(-len(shapes) // n_columns), n_columns))
    for index, shape in enumerate(shapes):
        plotter.subplot(*divmod(index, n_columns))
        plotter.add_mesh(_mode(mesh, shape), show_scalar_bar=False)
        plotter.add_text(f"mode {index + 1}", font_size=9)
    plotter.link_views()
    return plotter


class Film:
    """A film of a moving body: a .gif or .mp4 (which needs imageio). A context manager."""

    def __init__(
        self,
        path: str | PathLike[str],
        body: MeshSource | Arrays,
        fps: int = 30,
        size: tuple[int, int] = (640, 480),
        up: Literal["x", "y", "z"] = "y",
    ) -> None:
        """Begin the film at ``path``, seen along an axis, ``up`` upwards."""
        self._mesh = as_mesh(body)
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
