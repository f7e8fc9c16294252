"""``application/vnd.sutura.frame`` and state frames: arrays as they travel, viewed in place."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from .errors import DecodeError

FRAME = "application/vnd.sutura.frame"
NPY = "application/x-npy"
JSON = "application/json"

Buffer: TypeAlias = bytes | bytearray | memoryview
Array: TypeAlias = npt.NDArray[Any]
FloatArray: TypeAlias = npt.NDArray[np.floating[Any]]
DType: TypeAlias = Literal["f32", "f64"]
"""The element type that an array travels in."""

_MAGIC = b"SUTURA\x01\0"
_ALIGNMENT = 8
_MAX_ARRAYS = 32
_MAX_RANK = 4
_MAX_NAME_BYTES = 64
_MAX_COORDINATES = 1024
_DTYPES = (np.dtype("<f4"), np.dtype("<f8"), np.dtype("<u4"))


class Frame(Mapping[str, Array]):
    """Named arrays that belong to one generation. They are views of the bytes that arrived."""

    def __init__(self, data: Buffer) -> None:
        """View ``data``; raises DecodeError unless all of it is a frame."""
        self._arrays: dict[str, Array] = {}
        try:
            self.generation = self._decode(memoryview(data))
        except (struct.error, UnicodeDecodeError) as error:
            raise DecodeError(f"the frame's header cannot be read: {error}") from error

    def _decode(self, data: memoryview) -> int:
        if data[:8] != _MAGIC:
            raise DecodeError("the bytes do not start with the mark of a version 1 frame")
        generation, n_arrays = struct.unpack_from("<QQ", data, 8)
        if n_arrays > _MAX_ARRAYS:
            raise DecodeError(f"the frame announces {n_arrays} arrays, at most {_MAX_ARRAYS}")
        at = 24
        headers: list[tuple[str, np.dtype[Any], tuple[int, ...]]] = []
        for _ in range(n_arrays):
            (length,) = struct.unpack_from("<Q", data, at)
            if length > _MAX_NAME_BYTES:
                raise DecodeError(f"an array's name has {length} bytes, at most {_MAX_NAME_BYTES}")
            name = bytes(data[at + 8 : at + 8 + length]).decode()
            at += 8 + length
            code, rank = struct.unpack_from("<IQ", data, at)
            if code >= len(_DTYPES) or rank > _MAX_RANK:
                raise DecodeError(f"array {name!r} is of type {code} and rank {rank}")
            shape = struct.unpack_from(f"<{rank}Q", data, at + 12)
            at += 12 + 8 * rank
            if name in self._arrays or any(name == other for other, _, _ in headers):
                raise DecodeError(f"two arrays are named {name!r}")
            headers.append((name, _DTYPES[code], shape))
        for name, dtype, shape in headers:
            at += -at % _ALIGNMENT
            count = math.prod(shape)
            end = at + count * dtype.itemsize
            if end > len(data):
                raise DecodeError(f"array {name!r} ends at byte {end} of {len(data)}")
            self._arrays[name] = (
                np.frombuffer(data, dtype, count, min(at, len(data))).reshape(shape)
                if count
                else np.empty(shape, dtype)
            )
            at = end
        if at != len(data):
            raise DecodeError(f"the frame should have {at} bytes, but has {len(data)}")
        return int(generation)

    def __getitem__(self, name: str) -> Array:
        return self._arrays[name]

    def __iter__(self) -> Any:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def take(self, name: str, *shape: int | None) -> Array:
        """The array ``name``; its extents must be those of ``shape`` where that gives them."""
        array = self._arrays.get(name)
        if array is None:
            raise DecodeError(f"array {name!r} is missing; there are {sorted(self._arrays)}")
        wanted = [n if n is not None else m for n, m in zip(shape, array.shape, strict=False)]
        if array.ndim != len(shape) or list(array.shape) != wanted:
            raise DecodeError(f"array {name!r} has the shape {array.shape}, not {shape}")
        return array


_STATE_HEADER = struct.Struct("<QdQ7dI")


@dataclass(frozen=True, eq=False)
class State:
    """One published state of a running simulation."""

    sequence: int
    """Counts published states from 1; gaps are states that were dropped on the way."""
    time_s: float
    """Simulated time."""
    generation: int
    """The generation whose basis ``q`` refers to."""
    rigid: npt.NDArray[np.float64]
    """Rigid motion: position in m, then a unit quaternion x y z w."""
    q: npt.NDArray[np.float32]
    """Reduced coordinates."""

    @property
    def rotation(self) -> npt.NDArray[np.float64]:
        """The rotation of ``rigid`` as a matrix, (3, 3)."""
        x, y, z, w = self.rigid[3:]
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    @staticmethod
    def decode(data: Buffer) -> State:
        """Read a state frame; raises DecodeError unless all of ``data`` is one."""
        if len(data) < _STATE_HEADER.size:
            raise DecodeError(f"a state frame has at least {_STATE_HEADER.size} bytes")
        sequence, time_s, generation, *rigid, n = _STATE_HEADER.unpack_from(data)
        if n > _MAX_COORDINATES or len(data) != _STATE_HEADER.size + 4 * n:
            raise DecodeError(f"a state frame of {n} coordinates does not have {len(data)} bytes")
        q = np.frombuffer(data, "<f4", n, _STATE_HEADER.size) if n else np.empty(0, "<f4")
        if not (math.isfinite(time_s) and np.isfinite(rigid).all() and np.isfinite(q).all()):
            raise DecodeError("a state frame holds a number that is not finite")
        return State(sequence, time_s, generation, np.array(rigid), q)
