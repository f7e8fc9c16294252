"""The daemon's JSON documents as dataclasses.

Each keeps the document it was read from as ``raw``, so that members which a newer daemon sends are
not lost, and ignores them otherwise.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from typing import Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from .errors import DecodeError, Problem

Numbers: TypeAlias = npt.NDArray[np.float64]
Method: TypeAlias = Literal["flexibility", "low_rank", "from_scratch"]
Derivatives: TypeAlias = Literal["prepared", "own"]
"""How the linear modes follow an edit."""

_D = TypeVar("_D")


@dataclass(frozen=True, eq=False, kw_only=True)
class Document:
    """Something that the daemon said."""

    raw: Mapping[str, Any] = field(repr=False)
    """The JSON document itself."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SessionInfo(Document):
    """A session as the daemon describes it."""

    id: str
    name: str | None
    tenant: str | None
    """Whose it is, where the daemon asks for keys."""
    state: str
    """``building``, ``ready``, ``rebuilding`` or ``failed``; ``stored`` or ``restoring`` on disk."""
    stage: str | None
    progress: float
    generation: int
    oldest_generation: int | None
    n_vertices: int
    n_tets: int
    n_domains: int
    n_components: int
    n_free_dofs: int
    n_rigid_modes: int
    n_modes: int
    basis_size: int
    n_cubature_points: int | None
    n_stitches: int
    n_prepared_pairs: int
    frequencies_hz: Numbers
    memory_bytes: int
    timings_ms: dict[str, float]
    warnings: tuple[str, ...]
    parameters: dict[str, Any] | None
    error: Problem | None


@dataclass(frozen=True, eq=False, kw_only=True)
class SeamInfo(Document):
    """What a session has of candidate pairs."""

    n_pairs: int
    n_prepared_pairs: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate(Document):
    """What a generation claims of itself, estimated from residuals."""

    verdict: str
    """``patched`` from what was prepared, ``refined`` by solves, or ``rebuilt``."""
    lower_eigenvalue_error: float
    upper_eigenvalue_error: float
    basis_angle: float
    cubature_error: float | None
    is_met: bool
    is_unfinished: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Cubature(Document):
    """What is known of a generation's cubature rule."""

    n_points: int
    source: str
    validation_error: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Closing(Document):
    """What pulling pairs together did."""

    edit: int
    gaps_m: Numbers
    dropped_energy_j: float
    largest_displacement_m: float
    residual: float


@dataclass(frozen=True, eq=False, kw_only=True)
class EditReply(Document):
    """What an edit made."""

    generation: int
    method: str
    stitch_ids: tuple[int, ...]
    """Names of the stitches made, in the order of the request's pairs."""
    closings: tuple[Closing, ...]
    n_stitches: int
    n_rigid_modes: int
    eigenvalues_per_s2: Numbers
    frequencies_hz: Numbers
    residuals: Numbers
    certificate: Certificate
    basis_size: int
    cubature: Cubature | None
    timings_ms: dict[str, Any]
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulationInfo(Document):
    """A running simulation."""

    config: dict[str, Any]
    generation: int
    time_s: float
    sequence: int
    n_steps: int
    n_recovered: int
    n_late: int
    n_forces: int


@dataclass(frozen=True, eq=False, kw_only=True)
class GenerationInfo(Document):
    """A new generation."""

    generation: int
    n_modes: int
    basis_size: int
    n_stitches: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Event(Document):
    """What happens to a session: a member is None where this kind of event does not have it."""

    event: str
    """``state``, ``stage``, ``generation``, ``simulation``, ``failed`` or ``deleted``."""
    state: str | None = None
    generation: int | None = None
    stage: str | None = None
    progress: float | None = None
    n_modes: int | None = None
    basis_size: int | None = None
    n_stitches: int | None = None
    running: bool | None = None
    error: Problem | None = None


def read(cls: type[_D], document: Any) -> _D:
    """``document`` as a ``cls``; raises DecodeError and names the member that does not fit."""
    return _convert(cls, document, "")  # type: ignore[no-any-return]


@cache
def _members(cls: Any) -> tuple[tuple[str, Any, bool], ...]:
    hints = get_type_hints(cls)
    return tuple(
        (f.name, hints[f.name], f.default is MISSING and f.default_factory is MISSING)
        for f in fields(cls)
        if f.name != "raw"
    )


def _convert(hint: Any, value: Any, pointer: str) -> Any:
    def wrong() -> DecodeError:
        return DecodeError(f"{pointer or 'the document'} is {str(value)[:100]!r}, not {hint}")

    if hint is Any:
        return value
    if hint is Problem:
        return Problem.from_document(value)
    if isinstance(hint, type) and issubclass(hint, Document):
        if not isinstance(value, Mapping):
            raise wrong()
        found: dict[str, Any] = {"raw": value}
        kind: Any = hint
        for name, member, is_required in _members(kind):
            if name in value:
                found[name] = _convert(member, value[name], f"{pointer}/{name}")
            elif is_required:
                raise DecodeError(f"{pointer}/{name} is missing")
        return hint(**found)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        (hint,) = (argument for argument in arguments if argument is not type(None))
        return _convert(hint, value, pointer)
    if origin is np.ndarray:
        try:
            return np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise wrong() from error
    if origin is tuple and isinstance(value, list):
        return tuple(_convert(arguments[0], x, f"{pointer}/{i}") for i, x in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {k: _convert(arguments[1], x, f"{pointer}/{k}") for k, x in value.items()}
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if hint in (str, int, bool) and type(value) is hint:
        return value
    raise wrong()
