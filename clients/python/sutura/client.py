"""The daemon over HTTP."""

from __future__ import annotations

import contextlib
import io
import json as json_format
import os
import ssl
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal
from urllib.parse import urlsplit

import httpx
import numpy as np
from typing_extensions import Self

from .documents import SessionInfo, read
from .edits import Pairs, index_list, pair_list
from .errors import ConnectionFailedError, DecodeError, ProblemError, refusal, unexplained
from .frames import JSON, NPY, DType, FloatArray
from .mesh import Mesh, MeshSource, load
from .session import Session

DEFAULT_URL = "http://127.0.0.1:8080"

# How long a connection may take to be made. Answers may take as long as they need: an edit of a large
# body takes seconds.
_CONNECT_TIMEOUT_S = 10.0
_MAX_ARRAY_BYTES = 2 << 30
_LOOPBACK = ("localhost", "127.0.0.1", "::1")

Material = Mapping[str, Any]


def material(
    young_modulus_pa: float,
    poisson_ratio: float,
    density_kg_m3: float = 1000.0,
    law: str = "stvk",
    **more: Any,
) -> Material:
    """A material; ``law`` is ``stvk`` for St. Venant–Kirchhoff."""
    return {
        "law": law,
        "young_modulus_pa": float(young_modulus_pa),
        "poisson_ratio": float(poisson_ratio),
        "density_kg_m3": float(density_kg_m3),
        **more,
    }


class Client:
    """A daemon, reached over HTTP. May be shared by threads. A context manager, or ``close`` it."""

    def __init__(
        self,
        url: str | None = None,
        *,
        api_key: str | None = None,
        timeout_s: float | None = None,
        ca_file: str | Path | None = None,
    ) -> None:
        """Ask the daemon at ``url`` whether it is there.

        Without ``url`` the one that the variable SUTURA_SERVER names, or else the one on this machine;
        without ``api_key`` the key in SUTURA_KEY, if there is one.
        ``api_key`` is sent as a bearer token; ``timeout_s`` bounds the wait for each answer.
        ``ca_file``, or else the one in SUTURA_CA, holds the certificates (PEM) of the only authorities that
        an ``https`` address is trusted by, instead of the usual ones.
        """
        url = url or os.environ.get("SUTURA_SERVER") or DEFAULT_URL
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{url!r} is not the address of a daemon, such as {DEFAULT_URL}")
        self._base = url.rstrip("/")
        api_key = api_key or os.environ.get("SUTURA_KEY")
        self.headers = {} if api_key is None else {"authorization": f"Bearer {api_key}"}
        self.is_proxied = parts.hostname not in _LOOPBACK
        ca_file = ca_file or os.environ.get("SUTURA_CA")
        # Certificates take long to load and serve https alone.
        self.tls = ssl.create_default_context(cafile=ca_file) if parts.scheme == "https" else None
        self._http = self._connect(timeout_s)
        try:
            self.send("GET", "healthz")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close its connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self._base!r})"

    def create(
        self,
        mesh: MeshSource,
        *,
        material: Material | None = None,
        domain_materials: Mapping[int, Material] | None = None,
        fixed_vertices: Iterable[int] = (),
        seams: Pairs = (),
        name: str | None = None,
        n_modes: int | None = None,
        basis: Mapping[str, int] | None = None,
        cubature: Mapping[str, Any] | bool = True,
        damping: Mapping[str, float] | None = None,
        mass: Literal["lumped", "consistent"] | None = None,
        config: Mapping[str, Any] | str | Path | None = None,
        wait: bool = False,
        progress: bool = False,
    ) -> Session:
        """Open a session on a mesh: a file, a Mesh, (vertices, tets), a meshio mesh, a PyVista grid.

        ``config`` is a configuration as the contract has it, or a JSON file of one; the other
        arguments are laid over it, and what none of them says is at its default. ``cubature=False``
        sums over every tet. Returns as soon as the daemon has accepted it; ``wait`` and ``progress``
        wait until it is ready.
        """
        if isinstance(config, str | Path):
            document: dict[str, Any] = json_format.loads(Path(config).read_text())
        else:
            document = dict(config or {})
        fixed, pairs = index_list(fixed_vertices), pair_list(seams)
        by_label = {str(label): value for label, value in (domain_materials or {}).items()}
        given: dict[str, Any] = {
            "name": name,
            "material": material,
            "domain_materials": by_label or None,
            "fixed_vertices": fixed or None,
            "seams": pairs or None,
            "n_modes": n_modes,
            "basis": basis,
            "damping": damping,
            "mass": mass,
        }
        document.update({key: value for key, value in given.items() if value is not None})
        if cubature is False:
            document["cubature"] = None
        elif cubature is not True:
            document["cubature"] = cubature
        source = load(mesh)
        session = self.session(read(SessionInfo, self._create(source, document)).id)
        if wait or progress:
            session.wait_ready(progress)
        return session

    def _create(self, source: Mesh | Path, config: dict[str, Any]) -> Any:
        parts: list[tuple[str, IO[bytes]]] = []
        with contextlib.ExitStack() as files:
            if isinstance(source, Path):
                for path in _parts(source):
                    parts.append((path.name, files.enter_context(path.open("rb"))))
            else:
                encoded = source.to_msh()
                if encoded is None:
                    config = {**config, "mesh": source.to_document()}
                    return self.document("POST", "v1/sessions", json=config)
                parts.append(("mesh.msh", io.BytesIO(encoded)))
            form: list[tuple[str, Any]] = [
                ("config", (None, json_format.dumps(config), JSON)),
                *(("mesh", (name, file, "application/octet-stream")) for name, file in parts),
            ]
            return self.document("POST", "v1/sessions", files=form)

    def session(self, id: str) -> Session:
        """The session named ``id``, whether or not it exists."""
        return Session(self, id)

    def sessions(self, page: int = 50) -> Iterator[SessionInfo]:
        """Every session, in the order in which they were made; fetched ``page`` at a time."""
        after: str | None = None
        while True:
            parameters = {"limit": str(page)} | ({} if after is None else {"after": after})
            found = self.document("GET", "v1/sessions", params=parameters)
            if not isinstance(found, dict) or not isinstance(found.get("sessions"), list):
                raise DecodeError("not a list of sessions")
            for document in found["sessions"]:
                yield read(SessionInfo, document)
            after = found.get("next")
            if after is None:
                return

    def npy(self, session_id: str, resource: str, dtype: DType = "f32") -> FloatArray:
        """One array of the current generation as the .npy that other programs fetch."""
        path = f"v1/sessions/{session_id}/generations/current/{resource}"
        data = self.binary(path, NPY, {"dtype": dtype})
        array: FloatArray = np.load(io.BytesIO(data), allow_pickle=False)
        return array

    def url(self, path: str) -> str:
        """The address of a path on the daemon."""
        return f"{self._base}/{path}"

    def send(self, method: str, path: str, **content: Any) -> bytes:
        """Send a request; returns the body of the answer, or raises the refusal."""
        try:
            response = self._http.request(method, self.url(path), **content)
        except httpx.TimeoutException as error:
            raise TimeoutError(f"{self._base} does not answer in time") from error
        except httpx.HTTPError as error:
            raise ConnectionFailedError(f"{self._base}: {error}") from error
        if not response.is_success:
            raise _refused(response)
        return response.content

    def document(self, method: str, path: str, **content: Any) -> Any:
        """Send a request; returns the JSON document of the answer."""
        body = self.send(method, path, **content)
        try:
            return json_format.loads(body)
        except ValueError as error:
            raise DecodeError(f"the answer is not JSON: {error}") from error

    def binary(self, path: str, media_type: str, parameters: Mapping[str, str]) -> memoryview:
        """Fetch an answer of ``media_type`` into one buffer, aligned and writable."""
        with self._open(path, media_type, parameters, self._http) as response:
            found = response.headers.get("content-type")
            if found != media_type:
                raise DecodeError(f"the answer is {found}, not {media_type}")
            announced = int(response.headers.get("content-length", -1))
            if announced > _MAX_ARRAY_BYTES:
                raise DecodeError(f"the answer is larger than {_MAX_ARRAY_BYTES} bytes")
            if announced < 0:
                return memoryview(bytearray(response.read()))
            buffer = np.empty(announced, np.uint8)
            n_read = 0
            for chunk in response.iter_bytes():
                buffer[n_read : n_read + len(chunk)] = np.frombuffer(chunk, np.uint8)
                n_read += len(chunk)
            if n_read != announced:
                raise DecodeError(f"{n_read} bytes arrived where {announced} were announced")
            return buffer.data

    @contextlib.contextmanager
    def listen(self, path: str, timeout_s: float | None) -> Iterator[httpx.Response]:
        """An answer that goes on, on a connection of its own.

        Whoever abandons it in the middle leaves nothing behind in this client's pool.
        """
        with (
            self._connect(timeout_s) as http,
            self._open(path, "text/event-stream", {}, http) as response,
        ):
            yield response

    def _connect(self, timeout_s: float | None) -> httpx.Client:
        return httpx.Client(
            headers=self.headers,
            timeout=httpx.Timeout(timeout_s, connect=_CONNECT_TIMEOUT_S),
            trust_env=self.is_proxied,
            verify=self.tls or False,
        )

    @contextlib.contextmanager
    def _open(
        self, path: str, media_type: str, parameters: Mapping[str, str], http: httpx.Client
    ) -> Iterator[httpx.Response]:
        try:
            headers = {"accept": media_type}
            request = http.stream("GET", self.url(path), params=parameters, headers=headers)
            with request as response:
                if not response.is_success:
                    response.read()
                    raise _refused(response)
                yield response
        except httpx.TimeoutException as error:
            raise TimeoutError(f"{self._base} does not answer in time") from error
        except httpx.HTTPError as error:
            raise ConnectionFailedError(f"{self._base}: {error}") from error


def _refused(response: httpx.Response) -> ProblemError:
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        with contextlib.suppress(DecodeError, ValueError):
            return refusal(response.json(), response.headers.get("retry-after"))
    return unexplained(response.status_code, response.content)


def _parts(path: Path) -> list[Path]:
    """The files of a mesh: TetGen has its tets beside its nodes."""
    beside = {".node": ".ele", ".ele": ".node"}.get(path.suffix.lower())
    if beside is None:
        return [path]
    return [path, path.with_suffix(beside)]
