"""Client of the Sutura daemon: deformable bodies, kept ready for interactive editing.

``Client`` speaks HTTP, ``sutura.bus.ZenohClient`` Zenoh; either gives a session, whose arrays are
NumPy arrays. A running simulation is followed by ``Session.states`` and a ``Tracker``, which keeps the
basis in step with the stream's generations.

    import sutura

    client = sutura.Client("http://127.0.0.1:8080")
    session = client.create("organ.msh", material=sutura.material(5e5, 0.4), wait=True)
    reply = session.stitch([[17, 4021], [18, 4022]], stiffness_n_m=1e5)
    print(reply.frequencies_hz)
"""

from . import edits
from .arrays import Arrays, Block, Combination, Delta, Dictionary, Stitches, reconstruct
from .client import Client, material
from .documents import (
    Certificate,
    Closing,
    Cubature,
    EditReply,
    Event,
    GenerationInfo,
    SeamInfo,
    SessionInfo,
    SimulationInfo,
)
from .errors import (
    BuildFailedError,
    BusyError,
    ConflictError,
    ConnectionFailedError,
    DecodeError,
    ImpossibleError,
    MismatchError,
    NotFoundError,
    Problem,
    ProblemError,
    SuturaError,
)
from .evaluator import Evaluation, Evaluator
from .events import EventStream
from .frames import Frame, State
from .mesh import Mesh
from .progress import ProgressBars
from .session import Session
from .sessions import force, grab
from .states import StateStream
from .stepping import Stepper
from .tracker import Tracker

__all__ = [
    "Arrays",
    "Block",
    "BuildFailedError",
    "BusyError",
    "Certificate",
    "Client",
    "Closing",
    "Combination",
    "ConflictError",
    "ConnectionFailedError",
    "Cubature",
    "DecodeError",
    "Delta",
    "Dictionary",
    "EditReply",
    "Evaluation",
    "Evaluator",
    "Event",
    "EventStream",
    "Frame",
    "GenerationInfo",
    "ImpossibleError",
    "Mesh",
    "MismatchError",
    "NotFoundError",
    "Problem",
    "ProblemError",
    "ProgressBars",
    "SeamInfo",
    "Session",
    "SessionInfo",
    "SimulationInfo",
    "State",
    "StateStream",
    "Stepper",
    "Stitches",
    "SuturaError",
    "Tracker",
    "edits",
    "force",
    "grab",
    "material",
    "reconstruct",
]
