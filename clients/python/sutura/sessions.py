"""What a session can be asked and told, whichever way it is reached."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from . import edits
from .arrays import Arrays
from .documents import Derivatives, EditReply, Method, SeamInfo, SessionInfo, read
from .edits import Edit, Pairs
from .states import StateStream

Force = Mapping[str, Any]


def force(vertex: int, force_n: npt.ArrayLike, duration_s: float) -> Force:
    """A force of ``force_n`` N on one vertex, for so long."""
    x = np.asarray(force_n, dtype=np.float64)
    if x.shape != (3,):
        raise ValueError(f"a force has three components, not the shape {x.shape}")
    return {"vertex": int(vertex), "force_n": x.tolist(), "duration_s": float(duration_s)}


Grab = Mapping[str, Any]


def grab(
    id: int,
    vertex: int,
    target_m: npt.ArrayLike,
    stiffness_n_m: float,
    damping_n_s_m: float = 0.0,
) -> Grab:
    """A damped spring from a vertex to a point: a hand or a tool. Sent again by its name, it is moved."""
    x = np.asarray(target_m, dtype=np.float64)
    if x.shape != (3,):
        raise ValueError(f"a target has three coordinates, not the shape {x.shape}")
    return {
        "id": int(id),
        "vertex": int(vertex),
        "target_m": x.tolist(),
        "stiffness_n_m": float(stiffness_n_m),
        "damping_n_s_m": float(damping_n_s_m),
    }


class AnySession(Arrays):
    """A session, over HTTP or over Zenoh."""

    def __init__(self, id: str) -> None:
        """Name the session ``id``, whether or not it exists."""
        if not (0 < len(id) <= 64 and all(c.isascii() and (c.isalnum() or c in "-_") for c in id)):
            raise ValueError(f"{id!r} cannot be a session's identifier")
        self.id = id

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.id!r})"

    @abstractmethod
    def _ask(self, resource: str, request: Mapping[str, Any] | None) -> Any:
        """Send a document, or none, to ``info``, ``edits`` or ``seams``; returns the answer's."""

    @abstractmethod
    def push_forces(self, forces: Iterable[Force]) -> None:
        """Add forces to the running simulation; see ``force``."""

    @abstractmethod
    def hold(self, grabs: Iterable[Grab] = (), release: Iterable[int] = ()) -> None:
        """Take hold of vertices of the simulated body, see ``grab``, and let grabs go by their names."""

    @abstractmethod
    def states(self) -> StateStream:
        """The states that the simulation publishes."""

    def push_force(self, vertex: int, force_n: npt.ArrayLike, duration_s: float) -> None:
        """Pull at one vertex for so long, in s of simulated time."""
        self.push_forces([force(vertex, force_n, duration_s)])

    def info(self) -> SessionInfo:
        """What is known of it now."""
        return read(SessionInfo, self._ask("info", None))

    def add_seams(self, pairs: Pairs) -> SeamInfo:
        """Name candidate pairs, (n, 2), which the daemon prepares in the background."""
        return read(SeamInfo, self._ask("seams", {"pairs": edits.pair_list(pairs)}))

    def edit(
        self,
        changes: Edit | Iterable[Edit],
        *,
        method: Method | None = None,
        derivatives: Derivatives | None = None,
        tolerance: float | None = None,
        deadline_ms: float | None = None,
        base_generation: int | None = None,
        restore: int | None = None,
    ) -> EditReply:
        """Apply edits (see ``sutura.edits``), all or none, and wait for the new generation.

        ``method`` is how the linear modes follow; ``derivatives`` which modal derivatives the basis gets
        inside a seam; ``tolerance`` the relative eigenvalue error accepted in their lower half;
        ``deadline_ms`` asks for the best that fits, to be finished behind it; ``base_generation`` has
        the edit refused if another one is current; ``restore`` returns to a kept generation first.
        """
        request = edits.request(
            changes,
            method=method,
            derivatives=derivatives,
            tolerance=tolerance,
            deadline_ms=deadline_ms,
            base_generation=base_generation,
            restore=restore,
        )
        return read(EditReply, self._ask("edits", request))

    def stitch(self, pairs: Pairs, stiffness_n_m: float, **options: Any) -> EditReply:
        """Join pairs of coinciding vertices; options as for ``edit``."""
        return self.edit(edits.stitch(pairs, stiffness_n_m), **options)

    def unstitch(self, stitch_ids: Iterable[int] | None = None, **options: Any) -> EditReply:
        """Remove stitches by their names, or all; options as for ``edit``."""
        return self.edit(edits.unstitch(stitch_ids), **options)

    def set_stiffness(self, stitch_ids: Iterable[int], stiffness_n_m: float, **options: Any) -> EditReply:
        """Give stitches another stiffness; options as for ``edit``."""
        return self.edit(edits.set_stiffness(stitch_ids, stiffness_n_m), **options)

    def scale_stiffness(self, domain: int, factor: float, **options: Any) -> EditReply:
        """Multiply the stiffness of a domain; options as for ``edit``."""
        return self.edit(edits.scale_stiffness(domain, factor), **options)

    def fix(self, vertices: Iterable[int], **options: Any) -> EditReply:
        """Hold vertices where they rest; options as for ``edit``."""
        return self.edit(edits.fix(vertices), **options)

    def release(self, vertices: Iterable[int], **options: Any) -> EditReply:
        """Let vertices move that were held; options as for ``edit``."""
        return self.edit(edits.release(vertices), **options)

    def close_gap(
        self, pairs: Pairs, stiffness_n_m: float, max_gap_m: float | None = None, **options: Any
    ) -> EditReply:
        """Pull pairs together that do not coincide, and stitch them; options as for ``edit``."""
        return self.edit(edits.close(pairs, stiffness_n_m, max_gap_m), **options)

    def restore(self, generation: int) -> EditReply:
        """Return to a generation that is still kept: undo and redo, at no cost."""
        return self.edit([], restore=generation)
