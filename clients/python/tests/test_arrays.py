"""The arrays of a generation, checked against each other, over every way they travel."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import httpx
import numpy as np
import pytest
from conftest import CONFIG, SEAM, STIFFNESS_N_M, TIP, Daemon, bar, prepared

import sutura
from sutura.arrays import Arrays, Generation
from sutura.bus import ZenohClient
from sutura.frames import Frame

SINGLE = ("modes", "basis", "mass", "positions", "tets")


def test_arrays_are_bit_equal_however_they_travel(
    daemon: Daemon, client: sutura.Client, session: sutura.Session, zenoh_client: ZenohClient
) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    bus = zenoh_client.session(session.id)
    for resource in SINGLE:
        for dtype in ("f32", "f64"):
            framed = session.frame(resource, dtype=dtype)
            assert framed.generation == 1
            array = framed[resource]
            wanted = "<u4" if resource == "tets" else f"<f{int(dtype[1:]) // 8}"
            assert array.dtype == np.dtype(wanted)
            over_zenoh = bus.frame(resource, dtype=dtype)[resource]
            over_npy = client.npy(session.id, resource, dtype=dtype)  # type: ignore[arg-type]
            path = f"{daemon.http}/v1/sessions/{session.id}/generations/1/{resource}?dtype={dtype}"
            plain = httpx.get(path, headers={"accept": "application/x-npy"}, trust_env=False)
            read = np.load(io.BytesIO(plain.content))
            for other in (over_zenoh, over_npy, read):
                assert (other.dtype, other.shape) == (array.dtype, array.shape)
                assert other.tobytes() == array.tobytes()
    for resource, parameters in [
        ("combination", {}),
        ("evaluator", {}),
        ("stitches", {}),
        ("transfer", {"from": "0"}),
        ("delta", {"have": "0"}),
    ]:
        over_http = session.frame(resource, 1, **parameters)
        over_bus = bus.frame(resource, 1, **parameters)
        assert list(over_http) == list(over_bus) and len(over_http) > 0
        for name in over_http:
            assert over_http[name].tobytes() == over_bus[name].tobytes(), name


def test_the_body_and_its_stitches_come_back(session: sutura.Session) -> None:
    reply = session.stitch(SEAM, STIFFNESS_N_M)
    mesh = session.mesh()
    np.testing.assert_array_equal(mesh.vertices, bar().vertices)
    np.testing.assert_array_equal(mesh.tets, bar().tets)
    stitches = session.stitches()
    assert tuple(stitches.ids.tolist()) == reply.stitch_ids
    np.testing.assert_array_equal(stitches.pairs, SEAM)
    assert (stitches.stiffness_n_m == STIFFNESS_N_M).all()
    assert len(session.stitches(0).ids) == 0


def test_arrays_are_views_of_what_arrived(session: sutura.Session) -> None:
    frame = session.frame("basis")
    assert not frame["basis"].flags.owndata
    assert frame["basis"].flags.aligned and frame["basis"].flags.writeable


def test_modes_and_basis_are_orthonormal_in_the_lumped_mass(session: sutura.Session) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    for generation in (0, 1):
        mass = np.repeat(session.mass(generation, dtype="f64"), 3)
        assert mass.sum() / 3 == pytest.approx(0.5, abs=1e-12)
        for columns in (session.modes(generation, "f64"), session.basis(generation, "f64")):
            flat = columns.reshape(len(columns), -1)
            np.testing.assert_allclose((flat * mass) @ flat.T, np.eye(len(flat)), atol=1e-8)


def test_transfer_and_delta_lead_from_one_basis_to_the_next(
    session: sutura.Session, zenoh_client: ZenohClient
) -> None:
    session.stitch(SEAM[:5], STIFFNESS_N_M)
    session.stitch(SEAM[5:], STIFFNESS_N_M)
    bus = zenoh_client.session(session.id)
    mass = np.repeat(session.mass(dtype="f64"), 3)
    for start, end in [(0, 1), (1, 2), (0, 2), (2, 1)]:
        old, new = session.basis(start, "f64"), bus.basis(end, "f64")
        flat = [columns.reshape(len(columns), -1) for columns in (old, new)]
        transfer = session.transfer(end, start=start, dtype="f64")
        np.testing.assert_allclose(transfer, (flat[1] * mass) @ flat[0].T, atol=1e-8)
        delta = bus.delta(end, have=start, dtype="f64")
        error = (delta.apply(old) - new).reshape(len(new), -1)
        assert np.sqrt((error**2 * mass).sum(1)).max() < 1e-8
        with pytest.raises(sutura.MismatchError):
            delta.apply(old[1:])


class Counting(Arrays):
    """Counts the bytes that come from a source."""

    def __init__(self, source: Arrays) -> None:
        self.source = source
        self.n_bytes = 0

    def frame(self, resource: str, generation: Generation = "current", **parameters: str) -> Frame:
        frame = self.source.frame(resource, generation, **parameters)
        self.n_bytes += sum(array.nbytes for array in frame.values())
        return frame

    def since(self) -> int:
        n_bytes, self.n_bytes = self.n_bytes, 0
        return n_bytes


def combination_bytes(combination: sutura.Combination) -> int:
    """The most that a combination alone can take."""
    n_blocks = len(combination.blocks) + len(combination.prepared)
    return 8 + 12 * n_blocks + 4 * (1 + combination.size) * len(combination.columns)


def assert_follows(tracker: sutura.Tracker, session: sutura.Session, generation: int) -> None:
    """``tracker`` has ``generation`` to single precision."""
    assert tracker.generation == generation
    whole = session.basis(generation)
    assert np.abs(tracker.basis() - whole).max() <= 1e-6 * np.abs(whole).max()
    q = np.sin(1.0 + np.arange(len(whole)))
    exact = sutura.reconstruct(whole.astype(np.float64), q)
    assert np.abs(tracker.reconstruct(q) - exact).max() <= 2e-6 * np.abs(exact).max()


@pytest.mark.parametrize("over_zenoh", [False, True])
def test_w_alone_travels_after_an_edit_in_a_seam(
    session: sutura.Session, zenoh_client: ZenohClient, over_zenoh: bool
) -> None:
    session.add_seams(SEAM)
    prepared(session, len(SEAM))
    source = Counting(zenoh_client.session(session.id) if over_zenoh else session)
    tracker = sutura.Tracker(source)
    assert tracker.prefetch()
    source.since()
    for pairs in (SEAM[:4], SEAM[4:6]):
        reply = session.stitch(pairs, STIFFNESS_N_M)
        assert reply.certificate.verdict == "patched"
        tracker.follow(reply.generation)
        assert source.since() <= combination_bytes(session.combination())
        assert_follows(tracker, session, reply.generation)
    # Another base body: its columns take the place of the old ones.
    before = set(tracker.dictionary.blocks)
    assert len(before) > 1
    reply = session.fix([TIP])
    tracker.follow(reply.generation)
    assert not before & set(tracker.dictionary.blocks)
    assert_follows(tracker, session, reply.generation)


def test_blocks_are_fetched_once_whole_bases_have_cost_as_much(session: sutura.Session) -> None:
    session.add_seams(SEAM)
    prepared(session, len(SEAM))
    source = Counting(session)
    tracker = sutura.Tracker(source)
    total = last = source.since()
    for pair in SEAM:
        reply = session.stitch([pair], STIFFNESS_N_M)
        tracker.follow(reply.generation)
        assert_follows(tracker, session, reply.generation)
        last = source.since()
        total += last
    combination = session.combination()
    assert last <= combination_bytes(combination)
    column = 12 * combination.n_vertices
    bound = (combination.size + 2 * combination.n_columns) * column
    assert total <= bound + 10 * combination_bytes(combination)


def test_a_tracker_keeps_to_its_limit(session: sutura.Session) -> None:
    session.add_seams(SEAM)
    prepared(session, len(SEAM))
    combination = session.combination()
    limit = combination.n_columns * combination.n_vertices * 12
    tracker = sutura.Tracker(session, max_bytes=limit)
    assert not tracker.prefetch()
    for pair in SEAM[:3]:
        generation = session.stitch([pair], STIFFNESS_N_M).generation
        tracker.follow(generation)
        assert tracker.dictionary.n_bytes <= limit
        assert_follows(tracker, session, generation)


def pose(session: sutura.Session, size_m: float) -> Any:
    """Coordinates with every mode at work that bend the bar by about ``size_m``."""
    basis = session.basis(dtype="f64")
    n = 1.0 + np.arange(len(basis))
    q = np.sin(n) / n
    return q * size_m / np.abs(sutura.reconstruct(basis, q)).max()


def test_a_client_evaluates_on_its_own(session: sutura.Session, zenoh_client: ZenohClient) -> None:
    reply = session.stitch(SEAM, STIFFNESS_N_M)
    assert reply.cubature is not None
    evaluator = session.evaluator()
    assert (len(evaluator.tets), evaluator.size) == (reply.cubature.n_points, reply.basis_size)
    q = np.stack([pose(session, size) for size in (0.02, 0.005)])
    theirs, ours = session.evaluate(q), evaluator.evaluate(q)
    for name in ("energy_j", "force", "stiffness"):
        found, expected = getattr(ours, name), getattr(theirs, name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    single = session.evaluate(q[0])
    np.testing.assert_array_equal(single.force, theirs.force[0])
    np.testing.assert_allclose(evaluator.force(q[0]), theirs.force[0], rtol=1e-9)
    np.testing.assert_allclose(evaluator.energy_j(q), theirs.energy_j, rtol=1e-9)
    assert evaluator.evaluate(q[0]).stiffness.shape == (evaluator.size, evaluator.size)
    over_zenoh = zenoh_client.session(session.id).evaluator()
    np.testing.assert_array_equal(over_zenoh.basis_rows, evaluator.basis_rows)
    exact = session.evaluate(q[1], exact=True)
    error = np.linalg.norm(theirs.force[1] - exact.force) / np.linalg.norm(exact.force)
    assert 0 < error < 0.2
    with pytest.raises(sutura.MismatchError):
        evaluator.force(q[:, 1:])


@pytest.mark.parametrize("law", ["linear", "stvk", "neo_hookean", "mooney_rivlin", "corotational"])
def test_every_law_is_evaluated_as_the_daemon_does(client: sutura.Client, law: str) -> None:
    more = {"mooney_ratio": 0.3} if law == "mooney_rivlin" else {}
    materials = {1: sutura.material(5e5, 0.4, 1000.0, law, **more), 2: sutura.material(4e5, 0.3)}
    config = {**CONFIG, "material": None, "domain_materials": materials}
    session = client.create(bar(), **config, wait=True)
    session.stitch(SEAM, STIFFNESS_N_M)
    q = np.stack([pose(session, size) for size in (0.03, 0.0, -0.01)])
    theirs, ours = session.evaluate(q), session.evaluator().evaluate(q)
    for name in ("energy_j", "force", "stiffness"):
        found, expected = getattr(ours, name), getattr(theirs, name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    session.delete()


def test_force_is_the_gradient_of_energy_and_stiffness_that_of_force(
    session: sutura.Session,
) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    evaluator = session.evaluator()
    q = pose(session, 0.02)
    here = evaluator.evaluate(q)
    step = 1e-6 * np.abs(q).max()
    moved = step * np.eye(len(q))
    slope = (evaluator.energy_j(q + moved) - evaluator.energy_j(q - moved)) / (2 * step)
    np.testing.assert_allclose(slope, here.force, atol=1e-5 * np.abs(here.force).max())
    slope = (evaluator.force(q + moved) - evaluator.force(q - moved)) / (2 * step)
    np.testing.assert_allclose(slope, here.stiffness, atol=1e-5 * np.abs(here.stiffness).max())


def test_bytes_that_are_no_frame_are_refused() -> None:
    data = bytearray(
        b"SUTURA\x01\0"
        + (3).to_bytes(8, "little")
        + (1).to_bytes(8, "little")
        + (1).to_bytes(8, "little")
        + b"x"
        + (1).to_bytes(4, "little")
        + (1).to_bytes(8, "little")
        + (2).to_bytes(8, "little")
    )
    data += bytes(-len(data) % 8) + np.array([1.0, 2.0]).tobytes()
    frame = Frame(data)
    assert frame.generation == 3 and frame["x"].tolist() == [1.0, 2.0]
    with pytest.raises(sutura.DecodeError):
        frame.take("x", 3)
    with pytest.raises(sutura.DecodeError):
        frame.take("y", None)
    for end in range(len(data)):
        with pytest.raises(sutura.DecodeError):
            Frame(data[:end])
    random = np.random.default_rng(1)
    for _ in range(2000):
        broken = bytearray(data)
        for at in random.integers(0, 53, 3):
            broken[at] = random.integers(0, 256)
        with contextlib.suppress(sutura.DecodeError):
            Frame(broken)
