"""What can go wrong, as exceptions: a refusal carries the daemon's problem document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# How much of an answer that is no problem document an error quotes.
_MAX_QUOTED_CHARS = 300


class SuturaError(Exception):
    """Anything that this package raises on its own account."""


class ConnectionFailedError(SuturaError):
    """The daemon could not be reached, or the connection broke."""


class DecodeError(SuturaError):
    """The daemon's answer is not what the contract says."""


class MismatchError(SuturaError, ValueError):
    """Two things do not fit together: coordinates and a basis, a delta and its basis."""


@dataclass(frozen=True)
class Problem:
    """An RFC 9457 problem document."""

    type: str
    """A URI that names the kind of problem."""
    title: str
    """The kind of problem in words."""
    status: int
    """The HTTP status, over Zenoh too."""
    detail: str
    """What happened this time: names the vertex, tet, member or limit at fault."""
    instance_pointer: str | None = None
    """JSON pointer (RFC 6901) into the request, where one input is at fault."""

    @staticmethod
    def from_document(document: Any) -> Problem:
        """Read a problem document; raises DecodeError where it is none."""
        match document:
            case {"type": str(type_), "title": str(title), "status": int(status)}:
                detail = document.get("detail")
                pointer = document.get("instance_pointer")
                return Problem(
                    type_,
                    title,
                    status,
                    detail if isinstance(detail, str) else title,
                    pointer if isinstance(pointer, str) else None,
                )
        raise DecodeError(f"not a problem document: {str(document)[:_MAX_QUOTED_CHARS]}")

    def __str__(self) -> str:
        at = f" [at {self.instance_pointer}]" if self.instance_pointer else ""
        return f"{self.title} ({self.status}): {self.detail}{at}"


class ProblemError(SuturaError):
    """The daemon refused; ``problem`` says why, and ``pointer`` which input is at fault."""

    def __init__(self, problem: Problem, retry_after_s: float | None = None) -> None:
        super().__init__(str(problem))
        self.problem = problem
        self.retry_after_s = retry_after_s
        """When to try again, where the daemon is only busy."""

    @property
    def status(self) -> int:
        """The HTTP status, over Zenoh too."""
        return self.problem.status

    @property
    def pointer(self) -> str | None:
        """JSON pointer to the member of the request that is at fault."""
        return self.problem.instance_pointer


class NotFoundError(ProblemError):
    """No such session, generation or simulation (404)."""


class ConflictError(ProblemError):
    """Another generation is current than the one the edit was made for, or the like (409)."""


class ImpossibleError(ProblemError):
    """Well-formed, but no body could do it: pairs that do not coincide, an inverted tet (422)."""


class BusyError(ProblemError):
    """The daemon sheds load; try again after ``retry_after_s`` (429 or 503)."""


class BuildFailedError(ProblemError):
    """The session's build failed."""


_BY_STATUS: Mapping[int, type[ProblemError]] = {
    404: NotFoundError,
    409: ConflictError,
    422: ImpossibleError,
    429: BusyError,
    503: BusyError,
}


def refusal(document: Any, retry_after: str | None = None) -> ProblemError:
    """The exception for a problem document, by its status."""
    problem = Problem.from_document(document)
    seconds = float(retry_after) if retry_after and retry_after.isdecimal() else None
    return _BY_STATUS.get(problem.status, ProblemError)(problem, seconds)


def unexplained(status: int, body: bytes) -> ProblemError:
    """The exception for a refusal without a problem document, by a proxy for instance."""
    text = body.decode(errors="replace")[:_MAX_QUOTED_CHARS]
    document = {"type": "about:blank", "title": "Refused", "status": status, "detail": text}
    return refusal(document)
