"""The arrays of a session's generations, over either transport, and what is made of them: u = U q."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from .errors import DecodeError, MismatchError
from .evaluator import Evaluator
from .frames import DType, FloatArray, Frame
from .mesh import Mesh

Generation: TypeAlias = int | Literal["current"]


@dataclass(frozen=True)
class Block:
    """A block of columns by name."""

    id: int
    """Names the same columns as long as the daemon runs, and never any others."""
    n_columns: int


@dataclass(frozen=True, eq=False)
class Combination:
    """The basis of a generation as D·W, D being blocks side by side."""

    generation: int
    n_vertices: int
    blocks: tuple[Block, ...]
    columns: npt.NDArray[np.uint32]
    """The columns of D that take part, ascending."""
    w: FloatArray
    """(columns that take part, r)."""
    prepared: tuple[Block, ...]
    """Blocks that are prepared for further edits: to be fetched before they come."""

    @property
    def size(self) -> int:
        """The number of reduced coordinates r."""
        return int(self.w.shape[1])

    @property
    def n_columns(self) -> int:
        """Columns of its blocks, whether or not they take part."""
        return sum(block.n_columns for block in self.blocks)

    @staticmethod
    def decode(frame: Frame) -> Combination:
        """Read the frame of a combination."""
        (n_vertices,) = frame.take("n_vertices", 1)
        blocks = _blocks(frame, "blocks", "block_sizes")
        columns = frame.take("columns", None)
        w = frame.take("w", len(columns), None)
        total = sum(block.n_columns for block in blocks)
        if columns.dtype != np.uint32 or (np.diff(columns.astype(np.int64)) <= 0).any():
            raise DecodeError("the columns in use are not columns in order")
        if (columns >= total).any() or w.shape[1] > len(columns) or w.shape[1] == 0:
            raise DecodeError(f"W of the shape {w.shape} does not combine {total} columns")
        prepared = _blocks(frame, "prepared", "prepared_sizes")
        return Combination(frame.generation, int(n_vertices), blocks, columns, w, prepared)


def _long(halves: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint64]:
    """64-bit names, which travel as their lower and upper halves."""
    halves = halves.astype(np.uint64)
    names: npt.NDArray[np.uint64] = halves[:, 0] | halves[:, 1] << np.uint64(32)
    return names


def _blocks(frame: Frame, name: str, size_name: str) -> tuple[Block, ...]:
    names = _long(frame.take(name, None, 2)).tolist()
    sizes = frame.take(size_name, len(names))
    if len(set(names)) != len(names):
        raise DecodeError(f"{name!r} names a block twice")
    return tuple(Block(id_, int(size)) for id_, size in zip(names, sizes, strict=True))


@dataclass(eq=False)
class Dictionary:
    """Blocks of columns that a client holds, by name: (k, n_vertices, 3) each."""

    blocks: dict[int, FloatArray] = field(default_factory=dict)

    @property
    def n_bytes(self) -> int:
        """Bytes of the columns held."""
        return sum(columns.nbytes for columns in self.blocks.values())

    def missing(self, blocks: Iterable[Block]) -> list[Block]:
        """Those of ``blocks`` that are not held."""
        return [block for block in blocks if block.id not in self.blocks]

    def _parts(self, combination: Combination) -> Iterator[tuple[FloatArray, FloatArray]]:
        """For each block in use its columns that take part, (k, 3 n_vertices), and their rows of W."""
        sizes = (block.n_columns for block in combination.blocks)
        first = 0
        for block, end in zip(combination.blocks, itertools.accumulate(sizes), strict=True):
            low, high = np.searchsorted(combination.columns, [first, end])
            places = combination.columns[low:high] - np.uint32(first)
            first = end
            if not len(places):
                continue
            held = self.blocks.get(block.id)
            if held is None or held.shape != (block.n_columns, combination.n_vertices, 3):
                raise MismatchError(f"block {block.id} is not held, or is of another mesh")
            flat = held.reshape(block.n_columns, -1)
            is_run = places[-1] - places[0] + 1 == len(places)
            # A run of columns is a view; others are gathered.
            part = flat[places[0] : places[-1] + 1] if is_run else flat[places]
            yield part, combination.w[low:high]

    def reconstruct(self, combination: Combination, q: npt.ArrayLike) -> FloatArray:
        """D·(W·q): the displacement of every vertex in m, (n_vertices, 3)."""
        coordinates = _coordinates(q, combination.size)
        sums = np.zeros(3 * combination.n_vertices)
        for columns, rows in self._parts(combination):
            _add(sums, rows.astype(np.float64) @ coordinates, columns)
        return sums.astype(combination.w.dtype).reshape(-1, 3)

    def basis(self, combination: Combination) -> FloatArray:
        """D·W, multiplied out: (r, n_vertices, 3)."""
        shape = (combination.size, 3 * combination.n_vertices)
        result = np.empty(shape, combination.w.dtype)
        parts = list(self._parts(combination))
        for start in range(0, shape[1], _CHUNK):
            chunk = slice(start, start + _CHUNK)
            sums = sum(
                rows.T.astype(np.float64) @ columns[:, chunk].astype(np.float64) for columns, rows in parts
            )
            result[:, chunk] = sums
        return result.reshape(combination.size, -1, 3)


# Unknowns summed at a time: the copy of the columns in double precision stays in the cache.
_CHUNK = 4096


def _add(sums: npt.NDArray[np.float64], factors: FloatArray, columns: FloatArray) -> None:
    """Add Σ factor · column, in double precision.

    In single precision the rounding of some hundred terms would add up to twenty times that of the
    columns.
    """
    if columns.dtype == np.float64:
        sums += factors @ columns
        return
    for start in range(0, len(sums), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        sums[chunk] += factors @ columns[:, chunk].astype(np.float64)


def _coordinates(q: npt.ArrayLike, size: int) -> npt.NDArray[np.float64]:
    coordinates = np.asarray(q, dtype=np.float64)
    if coordinates.shape != (size,):
        raise MismatchError(f"coordinates of the shape {coordinates.shape} for a basis of {size}")
    return coordinates


def reconstruct(basis: FloatArray, q: npt.ArrayLike) -> FloatArray:
    """U = U q: the displacement of every vertex in m, (n_vertices, 3)."""
    if basis.ndim != 3:
        raise MismatchError(f"a basis has the shape (r, n_vertices, 3), not {basis.shape}")
    coordinates = _coordinates(q, basis.shape[0]).astype(basis.dtype)
    u: FloatArray = (coordinates @ basis.reshape(len(basis), -1)).reshape(-1, 3)
    return u


@dataclass(frozen=True, eq=False)
class Delta:
    """The difference between two bases: the new one is ``[old | columns] · w``."""

    generation: int
    have: int
    """The generation it starts from."""
    columns: FloatArray
    """(c, n_vertices, 3): columns that the old basis lacks."""
    w: FloatArray
    """(r of ``have`` + c, r)."""

    def apply(self, basis: FloatArray) -> FloatArray:
        """The new basis, made of the one of ``have``."""
        n_old = len(basis)
        if n_old + len(self.columns) != len(self.w) or (
            len(self.columns) and basis.shape[1:] != self.columns.shape[1:]
        ):
            detail = f"{basis.shape} and {self.columns.shape} for W of {self.w.shape}"
            raise MismatchError(f"this basis is not the one the delta starts from: {detail}")
        new = self.w[:n_old].T @ basis.reshape(n_old, -1)
        if len(self.columns):
            new += self.w[n_old:].T @ self.columns.reshape(len(self.columns), -1)
        return new.reshape(-1, *basis.shape[1:])


@dataclass(frozen=True, eq=False)
class Stitches:
    """The stitches in force."""

    pairs: npt.NDArray[np.uint32]
    """(s, 2): the vertices that each joins."""
    ids: npt.NDArray[np.uint64]
    """(s,): their names, for edits of them."""
    stiffness_n_m: npt.NDArray[np.float64]
    """(s,)."""


class Arrays(ABC):
    """The arrays of a session's generations. They are views of what arrived, not copies."""

    @abstractmethod
    def frame(self, resource: str, generation: Generation = "current", **parameters: str) -> Frame:
        """Fetch the frame of a resource, such as ``basis``."""

    def modes(self, generation: Generation = "current", dtype: DType = "f32") -> FloatArray:
        """Linear modes, mass-normalised: (n_modes, n_vertices, 3)."""
        return self.frame("modes", generation, dtype=dtype).take("modes", None, None, 3)

    def basis(self, generation: Generation = "current", dtype: DType = "f32") -> FloatArray:
        """The basis: (r, n_vertices, 3), UᵀMU = I."""
        return self.frame("basis", generation, dtype=dtype).take("basis", None, None, 3)

    def mass(self, generation: Generation = "current", dtype: DType = "f32") -> FloatArray:
        """Lumped mass of every vertex in kg: (n_vertices,)."""
        return self.frame("mass", generation, dtype=dtype).take("mass", None)

    def frequencies_hz(self, generation: Generation = "current", dtype: DType = "f64") -> FloatArray:
        """(n_modes,): frequencies of the elastic modes in Hz, ascending."""
        return self.frame("frequencies_hz", generation, dtype=dtype).take("frequencies_hz", None)

    def positions(self, generation: Generation = "current", dtype: DType = "f32") -> FloatArray:
        """Rest position of every vertex in m: (n_vertices, 3). A closing moves them."""
        return self.frame("positions", generation, dtype=dtype).take("positions", None, 3)

    def tets(self, generation: Generation = "current") -> npt.NDArray[np.uint32]:
        """The four corners of every tet, zero-based: (n_tets, 4)."""
        return self.frame("tets", generation).take("tets", None, 4)

    def mesh(self, generation: Generation = "current") -> Mesh:
        """The body at rest; its domains are not known."""
        positions = self.positions(generation, dtype="f64")
        return Mesh.of(positions, self.tets(generation))

    def stitches(self, generation: Generation = "current") -> Stitches:
        """The stitches in force."""
        frame = self.frame("stitches", generation, dtype="f64")
        pairs = frame.take("pairs", None, 2)
        ids = _long(frame.take("ids", len(pairs), 2))
        return Stitches(pairs, ids, frame.take("stiffness_n_m", len(pairs)))

    def transfer(self, generation: Generation = "current", *, start: int, dtype: DType = "f32") -> FloatArray:
        """(r, r of ``start``): q of ``generation`` = transfer @ q of generation ``start``."""
        parameters = {"from": str(start), "dtype": dtype}
        return self.frame("transfer", generation, **parameters).take("transfer", None, None)

    def delta(self, generation: Generation = "current", *, have: int, dtype: DType = "f32") -> Delta:
        """What a client that holds the basis of ``have`` needs to make that of ``generation``."""
        frame = self.frame("delta", generation, have=str(have), dtype=dtype)
        columns, w = frame.take("columns", None, None, 3), frame.take("w", None, None)
        return Delta(frame.generation, have, columns, w)

    def combination(self, generation: Generation = "current", dtype: DType = "f32") -> Combination:
        """The basis as a combination of named columns that generations share."""
        return Combination.decode(self.frame("combination", generation, dtype=dtype))

    def block(self, block: Block, generation: Generation = "current", dtype: DType = "f32") -> FloatArray:
        """The columns of a block of a generation's combination: (k, n_vertices, 3)."""
        frame = self.frame("dictionary", generation, blocks=str(block.id), dtype=dtype)
        return frame.take("dictionary", block.n_columns, None, 3)

    def evaluator(self, generation: Generation = "current", dtype: DType = "f64") -> Evaluator:
        """All it takes to evaluate energy, force and stiffness without the daemon."""
        return Evaluator.decode(self.frame("evaluator", generation, dtype=dtype))
