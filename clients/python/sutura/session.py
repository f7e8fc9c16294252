"""One session over HTTP."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from .arrays import Generation
from .documents import Event, GenerationInfo, SessionInfo, SimulationInfo, read
from .edits import index_list
from .errors import BuildFailedError, DecodeError, Problem
from .evaluator import Evaluation
from .events import EventStream
from .frames import FRAME, Frame
from .progress import listener
from .sessions import AnySession, Force, Grab
from .states import StateStream, WebSocketStates

if TYPE_CHECKING:
    from .client import Client

import numpy as np
import numpy.typing as npt

# States that end by themselves.
_COMING = ("building", "restoring")
# Longest time that one request may wait for a body to be restored.
_RESTORE_WAIT_S = "60"


class Session(AnySession):
    """A session, reached over HTTP."""

    def __init__(self, client: Client, id: str) -> None:
        """Name the session ``id`` of ``client``'s daemon, whether or not it exists."""
        super().__init__(id)
        self._client = client

    def _path(self, *segments: str) -> str:
        return "/".join(("v1/sessions", self.id, *segments))

    def _ask(self, resource: str, request: Mapping[str, Any] | None) -> Any:
        if request is None:
            return self._client.document("GET", self._path())
        return self._client.document("POST", self._path(resource), json=request)

    def frame(self, resource: str, generation: Generation = "current", **parameters: str) -> Frame:
        """Fetch the frame of a resource, such as ``basis``."""
        path = self._path("generations", str(generation), resource)
        return Frame(self._client.binary(path, FRAME, parameters))

    def wait_ready(
        self,
        progress: bool | Callable[[Event], None] = False,
        timeout_s: float | None = None,
    ) -> SessionInfo:
        """Wait until the build has ended; raises BuildFailedError if it failed, TimeoutError if late.

        A body that is kept on disk is restored.

        ``progress`` shows bars, or is told every event.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        on_event, bars = listener(progress)
        try:
            while True:
                # The first event is the state: an end of the build cannot slip through between.
                with self.events(_left(deadline)) as events:
                    for event in events:
                        on_event(event)
                        _left(deadline)
                        if not (event.event == "stage" or event.state in _COMING):
                            break
                info = self.info()
                if info.state == "failed":
                    unknown = Problem("about:blank", "The build failed", 422, "no reason is given")
                    raise BuildFailedError(info.error or unknown)
                if info.state == "stored":
                    # Asking for it with patience has it restored.
                    params = {"wait_s": _RESTORE_WAIT_S}
                    self._client.document("GET", self._path(), params=params)
                elif info.state not in _COMING:
                    return info
        finally:
            if bars is not None:
                bars.close()

    def events(self, timeout_s: float | None = None) -> EventStream:
        """What happens to it from now on, its present state first; ends with the session.

        Iterating raises TimeoutError if nothing comes for ``timeout_s``.
        """
        return EventStream(self._client.listen(self._path("events"), timeout_s))

    def generations(self, timeout_s: float | None = None) -> Iterator[GenerationInfo]:
        """Every new generation from now on."""
        events = self.events(timeout_s)
        return (read(GenerationInfo, e.raw) for e in events if e.event == "generation")

    def delete(self) -> None:
        """End it."""
        self._client.send("DELETE", self._path())

    def fork(self, name: str | None = None) -> Session:
        """Make a new session that shares everything prepared; named ``name``, or like this one."""
        request = {} if name is None else {"name": name}
        made = self._client.document("POST", self._path("fork"), json=request)
        return Session(self._client, read(SessionInfo, made).id)

    def evaluate(
        self, q: npt.ArrayLike, *, exact: bool = False, generation: Generation = "current"
    ) -> Evaluation:
        """Energy, force and stiffness at ``q``, (r,) or a batch (b, r), computed by the daemon.

        ``exact`` sums over every tet instead of the cubature points.
        """
        x = np.asarray(q, dtype=np.float64)
        path = self._path("generations", str(generation), "evaluate")
        reply = self._client.document("POST", path, json={"q": x.tolist(), "exact": exact})
        try:
            listed = [reply] if x.ndim == 1 else reply["evaluations"]
            energy, force, stiffness = (
                np.array([e[name] for e in listed], dtype=np.float64)
                for name in ("energy_j", "force", "stiffness")
            )
        except (KeyError, TypeError, ValueError) as error:
            raise DecodeError(f"not an evaluation: {error!r}") from error
        if x.ndim == 1:
            return Evaluation(energy[0], force[0], stiffness[0])
        return Evaluation(energy, force, stiffness)

    def simulate(
        self,
        *,
        dt_s: float | None = None,
        gravity_m_s2: npt.ArrayLike | None = None,
        publish_hz: float | None = None,
        integrator: str | None = None,
        **more: Any,
    ) -> SimulationInfo:
        """Start the simulation, or change how it goes on; what is not given is at its default."""
        members: dict[str, Any] = {
            "dt_s": dt_s,
            "gravity_m_s2": None if gravity_m_s2 is None else np.asarray(gravity_m_s2).tolist(),
            "publish_hz": publish_hz,
            "integrator": integrator,
            **more,
        }
        config = {name: value for name, value in members.items() if value is not None}
        document = self._client.document("PUT", self._path("simulation"), json=config)
        return read(SimulationInfo, document)

    def simulation(self) -> SimulationInfo:
        """What is known of the simulation now; raises NotFoundError if there is none."""
        return read(SimulationInfo, self._client.document("GET", self._path("simulation")))

    def stop_simulation(self) -> None:
        """End the simulation."""
        self._client.send("DELETE", self._path("simulation"))

    def push_forces(self, forces: Iterable[Force]) -> None:
        """Add forces to the running simulation; see ``force``."""
        path = self._path("simulation", "forces")
        self._client.send("POST", path, json={"forces": list(forces)})

    def hold(self, grabs: Iterable[Grab] = (), release: Iterable[int] = ()) -> None:
        """Take hold of vertices of the simulated body, see ``grab``, and let grabs go by their names."""
        request = {"grabs": list(grabs), "release": index_list(release)}
        self._client.send("POST", self._path("simulation", "grabs"), json=request)

    def states(self) -> StateStream:
        """The states that the simulation publishes, over a WebSocket."""
        url = self._client.url(self._path("stream"))
        return WebSocketStates(url, self._client.headers, self._client.is_proxied, self._client.tls)


def _left(deadline: float | None) -> float | None:
    if deadline is None:
        return None
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError("the session was not ready in time")
    return left
