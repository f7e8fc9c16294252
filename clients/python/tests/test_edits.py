"""The main job: from a mesh to stitched generations, over both transports."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import FIXED, PATIENCE_S, SEAM, STIFFNESS_N_M, TIP, bar, prepared

import sutura
from sutura import edits
from sutura.bus import ZenohClient


def half(frequencies: np.ndarray) -> np.ndarray:
    return frequencies[: len(frequencies) // 2]


def test_an_incision_is_closed_over_http_and_over_zenoh(
    session: sutura.Session, zenoh_client: ZenohClient
) -> None:
    before = session.info()
    assert (before.state, before.generation, before.n_rigid_modes) == ("ready", 0, 6)
    assert before.n_free_dofs == 3 * (2 * 45 - 9)
    first = session.stitch(SEAM[:5], STIFFNESS_N_M)
    assert (first.generation, first.n_stitches, first.n_rigid_modes) == (1, 5, 0)
    assert len(first.stitch_ids) == 5 and first.method == "flexibility"
    assert first.residuals.shape == first.frequencies_hz.shape
    assert first.timings_ms["total"] > 0

    bus = zenoh_client.session(session.id)
    generations = bus.generations()
    closed = bus.stitch(SEAM[5:], STIFFNESS_N_M, base_generation=1)
    assert (closed.generation, closed.n_stitches) == (2, 9)
    assert closed.frequencies_hz[0] > first.frequencies_hz[0]
    published = next(generations)
    if published.generation == 1:  # The first edit's, which was answered before it was published.
        published = next(generations)
    assert (published.generation, published.n_stitches) == (2, 9)
    generations.close()
    prepared(session, 9)
    assert session.info().raw == bus.info().raw

    fork = session.fork()
    fork.restore(0)
    truth = fork.stitch(SEAM, STIFFNESS_N_M, method="from_scratch")
    np.testing.assert_allclose(half(closed.frequencies_hz), half(truth.frequencies_hz), rtol=1e-4)
    fork.delete()


def test_undone_redone_and_changed_in_stiffness(session: sutura.Session) -> None:
    before = session.info()
    stitched = session.stitch(SEAM, STIFFNESS_N_M)
    undone = session.restore(0)
    assert (undone.generation, undone.n_stitches) == (2, 0)
    redone = session.restore(1)
    np.testing.assert_array_equal(redone.frequencies_hz, stitched.frequencies_hz)
    soft = session.set_stiffness(stitched.stitch_ids, 1.0)
    assert soft.frequencies_hz[0] < 0.9 * stitched.frequencies_hz[0]
    fewer = session.unstitch(stitched.stitch_ids[:3])
    assert fewer.n_stitches == 6
    opened = session.unstitch()
    assert (opened.n_stitches, opened.n_rigid_modes) == (0, 6)
    np.testing.assert_allclose(half(opened.frequencies_hz), half(before.frequencies_hz), rtol=1e-4)
    with pytest.raises(sutura.NotFoundError):
        session.restore(99)


def test_vertices_are_fixed_and_released(session: sutura.Session, zenoh_client: ZenohClient) -> None:
    before = session.info()
    fixed = session.fix(np.array([TIP - 1, TIP]))
    assert fixed.n_rigid_modes == 1
    assert session.info().n_free_dofs == before.n_free_dofs - 6
    assert (session.basis()[:, [TIP - 1, TIP]] == 0).all()
    released = zenoh_client.session(session.id).release([TIP - 1, TIP])
    assert released.n_rigid_modes == before.n_rigid_modes
    assert session.release(FIXED).n_rigid_modes == 12


def test_domains_grow_stiffer(session: sutura.Session) -> None:
    soft = session.stitch(SEAM, STIFFNESS_N_M)
    scales = [edits.scale_stiffness(domain, 4.0) for domain in (1, 2)]
    stiff = session.edit([*scales, edits.set_stiffness(soft.stitch_ids, 4 * STIFFNESS_N_M)])
    np.testing.assert_allclose(half(stiff.frequencies_hz), 2 * half(soft.frequencies_hz), rtol=1e-4)


def test_a_gap_is_closed(client: sutura.Client, zenoh_client: ZenohClient) -> None:
    mesh = bar()
    apart = mesh.vertices.copy()
    apart[45:] += (0.01, 0.002, 0.0)
    config = {"material": sutura.material(5e5, 0.4), "n_modes": 8}
    opened = sutura.Mesh.of(apart, mesh.tets, mesh.domains)
    session = client.create(opened, fixed_vertices=FIXED, config=config, cubature=False, wait=True)
    reply = session.close_gap(SEAM, STIFFNESS_N_M)
    (closing,) = reply.closings
    assert closing.gaps_m.shape == (9,) and (closing.gaps_m < 1e-9).all()
    assert closing.largest_displacement_m == pytest.approx(np.hypot(0.01, 0.002), abs=1e-6)
    rest = session.positions(dtype="f64")
    np.testing.assert_array_equal(rest, zenoh_client.session(session.id).positions(dtype="f64"))
    np.testing.assert_allclose(rest, mesh.vertices, atol=1e-7)
    session.delete()


def test_the_paper_s_method_is_offered(session: sutura.Session) -> None:
    held = session.stitch(SEAM[:5], STIFFNESS_N_M)
    reply = session.stitch(SEAM[5:], STIFFNESS_N_M, method="low_rank")
    assert reply.method == "low_rank" and reply.warnings
    assert reply.frequencies_hz[0] < 1.001 * held.frequencies_hz[0]


def test_edits_of_one_request_take_effect_together_or_not_at_all(session: sutura.Session) -> None:
    before = session.info()
    with pytest.raises(sutura.ImpossibleError) as refused:
        session.edit([edits.stitch(SEAM[:2], 1e5), edits.unstitch([77])])
    assert refused.value.pointer is not None and refused.value.pointer.startswith("/edits/1")
    assert session.info().raw == before.raw


def test_seams_are_prepared_and_a_deadline_is_kept(session: sutura.Session) -> None:
    assert session.add_seams(SEAM).n_pairs == len(SEAM)
    prepared(session, len(SEAM))
    events = session.events(timeout_s=PATIENCE_S)
    assert next(events).event == "state"
    first = session.stitch(SEAM, STIFFNESS_N_M, deadline_ms=0.0, tolerance=1e-11)
    certificate = first.certificate
    assert certificate.verdict == "patched"
    assert certificate.is_unfinished and not certificate.is_met
    made = (event.generation for event in events if event.event == "generation")
    assert first.generation + 1 in made
    events.close()
    reply = session.unstitch(first.stitch_ids, base_generation=first.generation)
    assert reply.n_stitches == 0
    part = session.stitch(SEAM[:4], STIFFNESS_N_M, derivatives="own")
    assert part.certificate.verdict == "refined" and not part.certificate.is_unfinished


def test_a_session_tells_of_its_edits(session: sutura.Session) -> None:
    generations = session.generations(timeout_s=PATIENCE_S)
    events = session.events(timeout_s=PATIENCE_S)
    assert next(events).state == "ready"
    reply = session.stitch(SEAM, STIFFNESS_N_M)
    stages = set()
    for event in events:
        if event.event == "stage":
            stages.add(event.stage)
        elif event.event == "generation":
            assert (event.generation, event.n_stitches) == (reply.generation, 9)
            break
    assert "modes" in stages
    assert next(generations).generation == reply.generation
    events.close()
    with pytest.raises(sutura.ImpossibleError) as refused:
        session.add_seams([SEAM[0], [SEAM[0, 0], SEAM[1, 1]]])
    assert refused.value.pointer == "/pairs/1"
