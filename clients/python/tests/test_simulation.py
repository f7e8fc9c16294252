"""A simulation, watched over both transports while the body is edited."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from conftest import FIXED, PATIENCE_S, SEAM, STIFFNESS_N_M, TIP

import sutura
from sutura.bus import ZenohClient
from sutura.states import StateStream

CONFIG: dict[str, Any] = {"dt_s": 0.002, "publish_hz": 500.0, "gravity_m_s2": (0.0, -9.81, 0.0)}


def take(states: StateStream) -> sutura.State:
    state = states.next(PATIENCE_S)
    assert state is not None, "the stream goes on"
    return state


def test_a_simulation_crosses_an_edit_without_a_jump(
    session: sutura.Session, zenoh_client: ZenohClient
) -> None:
    session.stitch(SEAM[:8], STIFFNESS_N_M)
    info = session.simulate(**CONFIG)
    assert (info.config["dt_s"], info.generation) == (0.002, 1)
    bus = zenoh_client.session(session.id)
    tracker = sutura.Tracker(bus)
    with bus.states() as states:
        state = take(states)
        while state.time_s < 0.3:
            state = take(states)
            displacement = tracker.displacement(state)
        assert (displacement[FIXED] == 0).all()
        assert displacement[TIP, 1] < -1e-4, "the tip sags"
        # The state at the switch is published in both generations. Either may be dropped on the way to
        # a slow consumer, so edit again until both have arrived.
        undo: tuple[int, ...] = ()
        while True:
            replies: list[sutura.EditReply] = []

            def edit(undo: tuple[int, ...] = undo, replies: list[Any] = replies) -> None:
                replies.append(session.unstitch(undo) if undo else session.stitch(SEAM[8:], STIFFNESS_N_M))

            editing = threading.Thread(target=edit)
            editing.start()
            generation = state.generation
            while state.generation == generation:
                before, state = state, take(states)
                assert state.time_s < 60, "the edit makes no new generation"
            at_last, after = tracker.displacement(before), tracker.displacement(state)
            assert tracker.generation == generation + 1
            editing.join()
            undo = replies[0].stitch_ids
            if before.time_s == state.time_s:
                break
    jump = np.linalg.norm(after - at_last) / np.linalg.norm(at_last)
    assert jump < 0.01
    assert session.simulation().n_recovered == 0


def test_states_arrive_over_websocket_and_zenoh_and_answer_to_forces(
    session: sutura.Session, zenoh_client: ZenohClient
) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    session.simulate(**{**CONFIG, "gravity_m_s2": (0, 0, 0)})
    bus = zenoh_client.session(session.id)
    tracker = sutura.Tracker(session)
    with session.states() as states, bus.states() as zenoh_states:
        first, second = take(states), take(states)
        assert second.sequence > first.sequence and second.time_s > first.time_s
        assert not second.q.any(), "nothing acts, nothing moves"
        session.push_force(TIP, (0.0, 0.0, 0.5), 60.0)
        while tracker.displacement(take(states))[TIP, 2] <= 1e-3:
            pass
        assert session.simulation().n_forces >= 1
        bus.push_forces([sutura.force(TIP, [0.0, 0.0, -2.0], 60.0)])
        while tracker.displacement(take(zenoh_states))[TIP, 2] >= -1e-3:
            pass
        newest = zenoh_states.latest(PATIENCE_S)
        assert newest is not None and newest.sequence > first.sequence
    assert session.simulate(publish_hz=20.0).config["publish_hz"] == 20.0
    session.stop_simulation()
    for ended in (session.simulation, lambda: session.push_force(TIP, (0, 0, 1), 1.0)):
        with pytest.raises(sutura.NotFoundError):
            ended()


def test_vertices_are_held_and_let_go(session: sutura.Session, zenoh_client: ZenohClient) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    session.simulate(**{**CONFIG, "gravity_m_s2": (0, 0, 0)})
    tracker = sutura.Tracker(session)
    target = session.positions(dtype="f64")[TIP] + (0.0, 0.0, 0.005)
    bus = zenoh_client.session(session.id)
    with session.states() as states:
        session.hold([sutura.grab(7, TIP, target, stiffness_n_m=200.0, damping_n_s_m=1.0)])
        while (here := tracker.positions(take(states))[TIP])[2] < target[2] - 0.003:
            assert np.isfinite(here).all()
        assert session.simulation().raw["n_grabs"] == 1
        bus.hold(release=[7])
        while session.simulation().raw["n_grabs"] > 0:
            take(states)


def test_a_free_body_falls_as_a_whole(session: sutura.Session) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    reply = session.release(FIXED)
    assert reply.n_rigid_modes == 6
    rest = session.positions(dtype="f64")
    mass = session.mass(dtype="f64")
    session.simulate(dt_s=0.002, publish_hz=200.0, gravity_m_s2=(0.0, -9.81, 0.0))
    tracker = sutura.Tracker(session)
    with session.states() as states:
        state = take(states)
        while state.time_s < 0.1:
            state = take(states)
        fallen = (mass @ (tracker.positions(state) - rest)) / mass.sum()
    np.testing.assert_allclose(fallen, [0, -0.5 * 9.81 * state.time_s**2, 0], atol=2e-3)


def test_a_body_that_nothing_holds_is_refused(session: sutura.Session) -> None:
    with pytest.raises(sutura.ImpossibleError, match="6 rigid mo"):
        session.simulate(**CONFIG)


def test_a_stream_ends_with_its_session(session: sutura.Session) -> None:
    size = session.stitch(SEAM, STIFFNESS_N_M).basis_size
    session.simulate(**CONFIG)
    with session.states() as states:
        take(states)
        session.delete()
        for state in states:
            assert state.q.shape == (size,)
    with pytest.raises(sutura.NotFoundError):
        session.states()


def test_a_client_steps_as_the_daemon_does(session: sutura.Session) -> None:
    session.stitch(SEAM, STIFFNESS_N_M)
    stepper = sutura.Stepper(session.evaluator(), CONFIG["dt_s"])
    session.simulate(**CONFIG)
    found: dict[int, Any] = {}
    with session.states() as states:
        state = take(states)
        while state.time_s < 0.2:
            found[round(state.time_s / CONFIG["dt_s"])] = state.q
            state = take(states)
    expected = {0: stepper.q}
    for step in range(1, max(found) + 1):
        expected[step] = stepper.step()
    scale = max(float(np.abs(q).max()) for q in expected.values())
    assert scale > 0
    for step, q in found.items():
        np.testing.assert_allclose(q, expected[step], atol=1e-5 * scale)
