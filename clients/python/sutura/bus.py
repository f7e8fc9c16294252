"""The daemon over Zenoh (``pip install sutura[zenoh]``)."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import zenoh
from typing_extensions import Self

from .arrays import Generation
from .documents import GenerationInfo, SessionInfo, read
from .edits import index_list
from .errors import ConnectionFailedError, DecodeError, NotFoundError, Problem, SuturaError, refusal
from .frames import Frame
from .sessions import AnySession, Force, Grab
from .states import QueuedStates, StateStream

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

_PREFIX = "sutura/v1"
# A key joins by the beginning of its SHA-256 as the name, and all of it as the password.
_N_USER_DIGITS = 12
_JSON = zenoh.Encoding.APPLICATION_JSON
# How long an answer may take: an edit of a large body takes seconds, from scratch minutes.
_QUERY_TIMEOUT_S = 600.0
# Largest message accepted.
_MAX_MESSAGE_BYTES = 1 << 30
# Answers of these are small: they go before arrays of many megabytes.
_URGENT = ("edits", "info")


class ZenohClient:
    """The daemons of a Zenoh network. A context manager, or ``close`` it."""

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        config: zenoh.Config | None = None,
        *,
        api_key: str | None = None,
        ca_file: str | Path | None = None,
    ) -> None:
        """Connect as a client to ``endpoint``, scouting off; or as ``config`` says.

        ``api_key``, or else the one in SUTURA_KEY, is shown when joining and with every query and
        publication. ``ca_file``, or else the one in SUTURA_CA, holds the certificates (PEM) of the only
        authorities that a ``tls/`` endpoint is trusted by, instead of those of the web.
        """
        ca_file = ca_file or os.environ.get("SUTURA_CA")
        self._api_key = api_key or os.environ.get("SUTURA_KEY")
        if config is None:
            config = zenoh.Config()
            for key, value in {
                "mode": "client",
                "connect/endpoints": [endpoint],
                "scouting/multicast/enabled": False,
                "scouting/gossip/enabled": False,
                "transport/link/rx/max_message_size": _MAX_MESSAGE_BYTES,
            }.items():
                config.insert_json5(key, json.dumps(value))
            if self._api_key is not None:
                digest = hashlib.sha256(self._api_key.encode()).hexdigest()
                login = {"user": digest[:_N_USER_DIGITS], "password": digest}
                config.insert_json5("transport/auth/usrpwd", json.dumps(login))
            if ca_file is not None:
                tls = {"root_ca_certificate": str(ca_file)}
                config.insert_json5("transport/link/tls", json.dumps(tls))
        try:
            self._zenoh_session = zenoh.open(config)
        except zenoh.ZError as error:
            raise ConnectionFailedError(f"Zenoh: {error}") from error

    def session(self, id: str) -> BusSession:
        """The session named ``id``, whether or not it exists."""
        return BusSession(self._zenoh_session, id, self._api_key)

    def sessions(self) -> list[SessionInfo]:
        """Every session of every daemon on the network."""
        replies = self._zenoh_session.get(
            f"{_PREFIX}/sessions/*/info",
            timeout=_QUERY_TIMEOUT_S,
            consolidation=zenoh.ConsolidationMode.NONE,
            attachment=self._api_key,
        )
        samples = (reply.ok for reply in replies)
        found = [read(SessionInfo, _json(s.payload)) for s in samples if s is not None]
        return sorted(found, key=lambda info: info.id)

    def daemons(self) -> list[str]:
        """The daemons that are up, by their names."""
        prefix = f"{_PREFIX}/daemons/"
        replies = self._zenoh_session.liveliness().get(f"{prefix}*")
        keys = (str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        return sorted(key.removeprefix(prefix) for key in keys)

    def close(self) -> None:
        """Close the connection."""
        self._zenoh_session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class BusSession(AnySession):
    """A session, reached over Zenoh."""

    def __init__(self, zenoh_session: zenoh.Session, id: str, api_key: str | None = None) -> None:
        """Name the session ``id``, whether or not it exists."""
        super().__init__(id)
        self._api_key = api_key
        self._zenoh_session = zenoh_session

    def _key(self, resource: str) -> str:
        return f"{_PREFIX}/sessions/{self.id}/{resource}"

    def _published(self, resource: str) -> str:
        """Where the daemon publishes: where it asks for keys, apart from other tenants."""
        tenant = None if self._api_key is None else self.info().tenant
        if tenant is None:
            return self._key(resource)
        return f"{_PREFIX}/tenants/{tenant}/sessions/{self.id}/{resource}"

    def _query(self, resource: str, parameters: str = "", payload: bytes | None = None) -> bytes:
        selector = f"{self._key(resource)}?{parameters}"
        urgent = resource in _URGENT
        try:
            replies = self._zenoh_session.get(
                selector,
                timeout=_QUERY_TIMEOUT_S,
                payload=payload,
                encoding=None if payload is None else _JSON,
                priority=zenoh.Priority.DATA if urgent else zenoh.Priority.DATA_LOW,
                attachment=self._api_key,
            )
            # Every daemon is asked; those that do not have the session say so (404). No daemon at all
            # ends the replies at once.
            refused: SuturaError | None = None
            for reply in replies:
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
                if (reply.err is not None) and (refused is None or isinstance(refused, NotFoundError)):
                    refused = refusal(_json(reply.err.payload))
        except zenoh.ZError as error:
            raise ConnectionFailedError(f"Zenoh: {error}") from error
        absent = Problem("about:blank", "Absent", 404, f"nobody answers for {self._key(resource)}")
        raise refused or NotFoundError(absent)

    def _ask(self, resource: str, request: Mapping[str, Any] | None) -> Any:
        payload = None if request is None else json.dumps(request).encode()
        return _parse(self._query(resource, payload=payload))

    def frame(self, resource: str, generation: Generation = "current", **parameters: str) -> Frame:
        """Fetch the frame of a resource, such as ``basis``."""
        given = {"generation": str(generation), **parameters}
        return Frame(self._query(resource, ";".join(f"{k}={v}" for k, v in given.items())))

    def _publish(self, resource: str, document: Mapping[str, Any]) -> None:
        try:
            self._zenoh_session.put(
                self._key(resource),
                json.dumps(document),
                encoding=_JSON,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
                attachment=self._api_key,
            )
        except zenoh.ZError as error:
            raise ConnectionFailedError(f"Zenoh: {error}") from error

    def push_forces(self, forces: Iterable[Force]) -> None:
        """Add forces to the running simulation; those the daemon refuses are lost."""
        self._publish("forces", {"forces": list(forces)})

    def hold(self, grabs: Iterable[Grab] = (), release: Iterable[int] = ()) -> None:
        """Take hold of vertices of the simulated body, see ``grab``, and let grabs go by their names.

        What the daemon refuses is lost.
        """
        self._publish("grabs", {"grabs": list(grabs), "release": index_list(release)})

    def states(self) -> StateStream:
        """The states that the simulation publishes."""
        stream = QueuedStates()
        subscriber = self._zenoh_session.declare_subscriber(
            self._published("state"), lambda sample: stream.push(sample.payload.to_bytes())
        )
        stream.on_close = subscriber.undeclare
        return stream

    def generations(self) -> Iterator[GenerationInfo]:
        """Every new generation from now on."""
        subscriber = self._zenoh_session.declare_subscriber(self._published("generation"))
        return _generations(subscriber)


def _generations(subscriber: Any) -> Iterator[GenerationInfo]:
    try:
        for sample in subscriber:
            yield read(GenerationInfo, _json(sample.payload))
    finally:
        subscriber.undeclare()


def _json(payload: zenoh.ZBytes) -> Any:
    return _parse(payload.to_bytes())


def _parse(data: bytes) -> Any:
    try:
        return json.loads(data)
    except ValueError as error:
        raise DecodeError(f"the answer is not JSON: {error}") from error
