"""Edits: what changes a body. Each function makes one entry of ``Session.edit``'s list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from .documents import Derivatives, Method

Edit: TypeAlias = Mapping[str, Any]
Pairs: TypeAlias = npt.ArrayLike
"""(n, 2) vertices, zero-based."""


def stitch(pairs: Pairs, stiffness_n_m: float) -> Edit:
    """Join pairs of coinciding vertices by zero-length springs."""
    return {"stitch": {"pairs": pair_list(pairs), "stiffness_n_m": float(stiffness_n_m)}}


def unstitch(stitch_ids: Iterable[int] | None = None) -> Edit:
    """Remove the stitches of these names (``EditReply.stitch_ids``); without names, all."""
    if stitch_ids is None:
        return {"unstitch_all": {}}
    return {"unstitch": {"stitch_ids": index_list(stitch_ids)}}


def set_stiffness(stitch_ids: Iterable[int], stiffness_n_m: float) -> Edit:
    """Give stitches another stiffness; they keep their names."""
    ids = index_list(stitch_ids)
    return {"set_stiffness": {"stitch_ids": ids, "stiffness_n_m": float(stiffness_n_m)}}


def scale_stiffness(domain: int, factor: float) -> Edit:
    """Multiply the stiffness of a domain, relative to the one in force."""
    return {"scale_stiffness": {"domain": int(domain), "factor": float(factor)}}


def fix(vertices: Iterable[int]) -> Edit:
    """Hold vertices where they rest."""
    return {"fix": {"vertices": index_list(vertices)}}


def release(vertices: Iterable[int]) -> Edit:
    """Let vertices move that were held."""
    return {"release": {"vertices": index_list(vertices)}}


def close(pairs: Pairs, stiffness_n_m: float, max_gap_m: float | None = None) -> Edit:
    """Pull pairs together that do not coincide, and stitch them; the shape becomes the rest shape."""
    edit = {"pairs": pair_list(pairs), "stiffness_n_m": float(stiffness_n_m)}
    return {"close": edit if max_gap_m is None else {**edit, "max_gap_m": float(max_gap_m)}}


def request(
    edits: Edit | Iterable[Edit],
    *,
    method: Method | None = None,
    derivatives: Derivatives | None = None,
    tolerance: float | None = None,
    deadline_ms: float | None = None,
    base_generation: int | None = None,
    restore: int | None = None,
) -> dict[str, Any]:
    """The request's document; what is not given is left to the daemon."""
    listed = [edits] if isinstance(edits, Mapping) else list(edits)
    members = {
        "method": method,
        "derivatives": derivatives,
        "tolerance": tolerance,
        "deadline_ms": deadline_ms,
        "base_generation": base_generation,
        "restore": restore,
    }
    given = {name: value for name, value in members.items() if value is not None}
    return {"edits": listed, **given}


def index_list(indices: Iterable[int]) -> list[int]:
    """Indices as JSON takes them."""
    return _whole(np.asarray(indices if isinstance(indices, np.ndarray) else list(indices)), 1)


def pair_list(pairs: Pairs) -> list[list[int]]:
    """Pairs as JSON takes them."""
    listed: list[list[int]] = _whole(np.asarray(pairs), 2)
    return listed


def _whole(array: npt.NDArray[Any], rank: int) -> list[Any]:
    if array.size == 0:
        return []
    if array.ndim != rank or array.dtype.kind not in "iu" or (rank == 2 and array.shape[1] != 2):
        what = "pairs of integers" if rank == 2 else "integers"
        raise ValueError(f"{what} are needed, not {array.dtype} of the shape {array.shape}")
    listed: list[Any] = array.tolist()
    return listed
