"""The states of a running simulation, as iterators over a WebSocket or a Zenoh subscription."""

from __future__ import annotations

import contextlib
import json
import ssl
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from types import TracebackType
from urllib.parse import urlsplit

from typing_extensions import Self
from websockets.exceptions import ConnectionClosed, ConnectionClosedOK, InvalidStatus
from websockets.sync.client import connect

from .errors import ConnectionFailedError, DecodeError, refusal, unexplained
from .frames import State

_MAX_FRAME_BYTES = 84 + 4 * 1024
# States that wait for a slow consumer.
_BACKLOG = 4
# The daemon's farewell stands behind the states that nobody takes any more.
_CLOSE_TIMEOUT_S = 0.1


class StateStream(ABC):
    """Published states, the oldest first; iterating ends when the daemon closes the stream.

    A consumer that is too slow misses some (gaps in ``State.sequence``). Use it as a context manager,
    or ``close`` it.
    """

    @abstractmethod
    def next(self, timeout_s: float | None = None) -> State | None:
        """The next state; None once the stream has ended. Raises TimeoutError."""

    @abstractmethod
    def close(self) -> None:
        """End the stream."""

    def latest(self, timeout_s: float | None = None) -> State | None:
        """The newest state there is, those before it thrown away; waits if none has come."""
        state = self.next(timeout_s)
        while state is not None:
            try:
                newer = self.next(0.0)
            except TimeoutError:
                return state
            if newer is None:
                return state
            state = newer
        return None

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> State:
        state = self.next()
        if state is None:
            raise StopIteration
        return state

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class WebSocketStates(StateStream):
    """States over a WebSocket."""

    def __init__(self, url: str, headers: dict[str, str], is_proxied: bool, tls: ssl.SSLContext | None) -> None:
        """Connect to ``url``; raises the daemon's refusal."""
        address = urlsplit(url)._replace(scheme="wss" if url.startswith("https") else "ws")
        self._closing = contextlib.ExitStack()
        try:
            connection = connect(
                address.geturl(),
                additional_headers=headers,
                max_size=_MAX_FRAME_BYTES,
                max_queue=_BACKLOG,
                close_timeout=_CLOSE_TIMEOUT_S,
                proxy=True if is_proxied else None,
                ssl=tls,
            )
            self._socket = self._closing.enter_context(connection)
        except InvalidStatus as error:
            body = bytes(error.response.body or b"")
            try:
                raise refusal(json.loads(body)) from None
            except (ValueError, DecodeError):
                raise unexplained(error.response.status_code, body) from None
        except (OSError, TimeoutError) as error:
            raise ConnectionFailedError(f"the stream of states: {error}") from error

    def next(self, timeout_s: float | None = None) -> State | None:
        """The next state; None once the stream has ended. Raises TimeoutError."""
        try:
            message = self._socket.recv(timeout_s)
        except ConnectionClosedOK:
            return None
        except ConnectionClosed as error:
            raise ConnectionFailedError(f"the stream of states broke off: {error}") from error
        if isinstance(message, str):
            raise DecodeError("text on the stream of states")
        return State.decode(message)

    def close(self) -> None:
        """End the stream."""
        self._closing.close()


class QueuedStates(StateStream):
    """States that are pushed from another thread, by a Zenoh subscription."""

    def __init__(self) -> None:
        """Make an empty stream."""
        self._waiting: deque[bytes] = deque(maxlen=_BACKLOG)
        self._changed = threading.Condition()
        self._is_closed = False
        self.on_close: Callable[[], None] = lambda: None

    def push(self, data: bytes) -> None:
        """Take a state frame; the oldest is dropped where too many wait."""
        with self._changed:
            self._waiting.append(data)
            self._changed.notify()

    def next(self, timeout_s: float | None = None) -> State | None:
        """The next state; None once the stream was closed. Raises TimeoutError."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while not self._waiting:
                if self._is_closed:
                    return None
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    raise TimeoutError(f"no state within {timeout_s} s")
                self._changed.wait(left)
            data = self._waiting.popleft()
        return State.decode(data)

    def close(self) -> None:
        """End the stream."""
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            self._changed.notify_all()
        self.on_close()
