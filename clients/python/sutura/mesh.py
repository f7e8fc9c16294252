"""Tetrahedral meshes on their way to the daemon."""

from __future__ import annotations

import io
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from .errors import MismatchError

# What a file format calls the label of a cell; the first that a mesh has is taken.
_DOMAIN_KEYS = ("domain", "gmsh:physical", "gmsh:geometrical", "medit:ref", "tetgen:ref")
_VTK_TETRA = 10


@dataclass(frozen=True, eq=False)
class Mesh:
    """A tetrahedral mesh: vertices in m, corners of each tet (zero-based), a label for each tet."""

    vertices: npt.NDArray[np.float64]
    """(n_vertices, 3)."""
    tets: npt.NDArray[np.uint32]
    """(n_tets, 4), positively oriented."""
    domains: npt.NDArray[np.int64]
    """(n_tets,): what materials and stiffness scaling refer to; 0 where the mesh has no labels."""

    @staticmethod
    def of(vertices: npt.ArrayLike, tets: npt.ArrayLike, domains: npt.ArrayLike | None = None) -> Mesh:
        """Make a mesh of arrays; whether its tets are sound is for the daemon to say."""
        points = np.ascontiguousarray(vertices, dtype=np.float64)
        given = np.asarray(tets)
        if points.ndim != 2 or points.shape[1] != 3:
            raise MismatchError(f"vertices have the shape {points.shape}, not (n_vertices, 3)")
        if given.ndim != 2 or given.shape[1] != 4 or given.dtype.kind not in "iu":
            detail = f"{given.dtype} of the shape {given.shape}"
            raise MismatchError(f"tets are {detail}, not integers of the shape (n_tets, 4)")
        if given.size and (given.min() < 0 or given.max() >= len(points)):
            tet = int(np.argmax(((given < 0) | (given >= len(points))).any(axis=1)))
            n = len(points)
            raise MismatchError(f"tet {tet} is {given[tet].tolist()}, but there are {n} vertices")
        corners = np.ascontiguousarray(given, dtype=np.uint32)
        if domains is None:
            return Mesh(points, corners, np.zeros(len(corners), np.int64))
        labels = np.asarray(domains)
        if labels.dtype.kind == "f" and (labels == np.rint(labels)).all():
            labels = labels.astype(np.int64)
        if labels.shape != (len(corners),) or labels.dtype.kind not in "iu":
            detail = f"{labels.dtype} of the shape {labels.shape}"
            raise MismatchError(f"domains are {detail}, not integers of the shape ({len(given)},)")
        return Mesh(points, corners, labels.astype(np.int64))

    @staticmethod
    def of_grid(mesh: Any, domains: str | None = None) -> Mesh:
        """Make a mesh of a meshio mesh or a PyVista grid: its tetrahedra, other cells left out.

        ``domains`` names the cell data to take as labels; without it, the first of those that
        mesh formats usually have.
        """
        points = np.asarray(mesh.points, dtype=np.float64)
        if points.ndim == 2 and points.shape[1] == 2:
            raise MismatchError("the mesh lies in the plane: it has no tetrahedra")
        if hasattr(mesh, "cell_data_dict"):
            tets = mesh.cells_dict.get("tetra")
            per_type = {name: data.get("tetra") for name, data in mesh.cell_data_dict.items()}
        else:
            tets = mesh.cells_dict.get(_VTK_TETRA)
            chosen = mesh.celltypes == _VTK_TETRA
            per_type = {name: mesh.cell_data[name][chosen] for name in mesh.cell_data}
        if tets is None:
            found = ", ".join(str(kind) for kind in mesh.cells_dict) or "nothing"
            raise MismatchError(f"the mesh has no tetrahedra, but {found}")
        if domains is not None and per_type.get(domains) is None:
            raise MismatchError(f"the tetrahedra have no cell data called {domains!r}")
        names = (domains,) if domains is not None else _DOMAIN_KEYS
        labels = next((per_type[name] for name in names if per_type.get(name) is not None), None)
        return Mesh.of(points, np.asarray(tets), labels)

    @staticmethod
    def read(path: str | PathLike[str], domains: str | None = None) -> Mesh:
        """Read a mesh file with meshio (``pip install sutura[mesh]``)."""
        import meshio

        return Mesh.of_grid(meshio.read(path), domains)

    def to_msh(self) -> bytes | None:
        """The mesh as a binary Gmsh 2.2 file; None if a label needs more than 32 bits."""
        limits = np.iinfo(np.int32)
        if self.domains.size and not (limits.min <= self.domains.min() and self.domains.max() <= limits.max):
            return None
        nodes = np.empty(len(self.vertices), [("tag", "<i4"), ("x", "<f8", 3)])
        nodes["tag"] = np.arange(1, len(nodes) + 1)
        nodes["x"] = self.vertices
        names = ["number", "physical", "elementary"]
        elements = np.empty(len(self.tets), [(n, "<i4") for n in names] + [("tet", "<i4", 4)])
        elements["number"] = np.arange(1, len(elements) + 1)
        elements["physical"] = elements["elementary"] = self.domains
        elements["tet"] = self.tets
        elements["tet"] += 1
        file = io.BytesIO()
        file.write(b"$MeshFormat\n2.2 1 8\n\x01\0\0\0\n$EndMeshFormat\n")
        file.write(b"$Nodes\n%d\n" % len(nodes) + nodes.tobytes() + b"\n$EndNodes\n")
        file.write(b"$Elements\n%d\n" % len(elements))
        file.write(np.array([4, len(elements), 2], "<i4").tobytes() + elements.tobytes())
        file.write(b"\n$EndElements\n")
        return file.getvalue()

    def to_document(self) -> dict[str, Any]:
        """The mesh as the contract's JSON."""
        return {
            "vertices": self.vertices.tolist(),
            "tets": self.tets.tolist(),
            "domains": self.domains.tolist(),
        }


MeshSource: TypeAlias = "Mesh | str | PathLike[str] | tuple[npt.ArrayLike, npt.ArrayLike] | Any"
"""A mesh file, a Mesh, (vertices, tets), a meshio mesh, or a PyVista grid."""


def load(source: MeshSource) -> Mesh | Path:
    """A mesh of whatever can be made one; files are left to the daemon."""
    if isinstance(source, Mesh):
        return source
    if isinstance(source, str | PathLike):
        return Path(source)
    if isinstance(source, tuple) and len(source) in (2, 3):
        return Mesh.of(*source)
    if hasattr(source, "points") and hasattr(source, "cells_dict"):
        return Mesh.of_grid(source)
    raise TypeError(
        f"a {type(source).__name__} is no mesh: give a file, a Mesh, (vertices, tets), "
        "a meshio mesh or a PyVista grid"
    )
