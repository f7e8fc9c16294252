"""What happens to a session, as it happens: server-sent events."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from types import TracebackType

import httpx
from typing_extensions import Self

from .documents import Event, read
from .errors import DecodeError

_MAX_EVENT_CHARS = 1 << 20


class EventStream(Iterator[Event]):
    """Events, the session's present state first; iterating ends with the session.

    It has a connection of its own, to be closed: use it as a context manager, or ``close`` it.
    Iterating raises TimeoutError if nothing comes for the time that was given.
    """

    def __init__(self, connection: contextlib.AbstractContextManager[httpx.Response]) -> None:
        """Listen on ``connection``."""
        self._closing = contextlib.ExitStack()
        self._lines = self._closing.enter_context(connection).iter_lines()

    def __next__(self) -> Event:
        data: list[str] = []
        n_chars = 0
        try:
            for line in self._lines:
                # Only `data` matters: the document repeats the event's name.
                if line.startswith("data:"):
                    data.append(line[5:].removeprefix(" "))
                    n_chars += len(line)
                    if n_chars > _MAX_EVENT_CHARS:
                        raise DecodeError(f"an event has more than {_MAX_EVENT_CHARS} characters")
                elif not line and data:
                    return read(Event, json.loads("\n".join(data)))
        except ValueError as error:
            raise DecodeError(f"an event is not JSON: {error}") from error
        except httpx.TimeoutException as error:
            raise TimeoutError("nothing happens to the session in the time given") from error
        except httpx.StreamClosed:
            pass
        self.close()
        raise StopIteration

    def close(self) -> None:
        """Listen no longer."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
