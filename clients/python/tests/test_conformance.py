"""The cases that every client is held to: tests/data/conformance."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, prepared

import sutura

FOLDER = ROOT / "tests/data/conformance"
CASES = json.loads((FOLDER / "cases.json").read_text())


def entry(name: str, *values: Any) -> bytes:
    """What was received: its name, and its numbers as little-endian bytes."""
    arrays = [np.ascontiguousarray(value) for value in values]
    numbers = b"".join(array.astype(array.dtype.newbyteorder("<")).tobytes() for array in arrays)
    return f"{name}\n".encode() + numbers + b"\n"


def assert_has(found: Any, expected: dict[str, Any], place: str) -> None:
    for name, value in expected.items():
        if isinstance(value, dict):
            assert_has(found[name], value, f"{place}, {name}")
        else:
            assert found[name] == value, f"{place}: {name}"


class Run:
    """One case on one session."""

    def __init__(self, client: sutura.Client, case: dict[str, Any]) -> None:
        self.client = client
        mesh = json.loads((FOLDER / "bar.json").read_text())
        body = sutura.Mesh.of(mesh["vertices"], mesh["tets"], mesh["domains"])
        self.session = client.create(body, config=case["config"], wait=True)

    def step(self, step: dict[str, Any], place: str) -> bytes:
        """Take a step; what was received."""
        session = self.session
        match step:
            case {"info": expected}:
                assert_has(session.info().raw, expected, place)
                return b""
            case {"prepared": count}:
                prepared(session, count)
                return b""
            case {"edit": request, "reply": expected}:
                reply = session.edit(request["edits"], **options(request))
                assert_has(reply.raw, expected, place)
                return entry("frequencies", reply.frequencies_hz)
            case {"edit": request, "problem": expected}:
                with pytest.raises(sutura.ProblemError) as refused:
                    session.edit(request["edits"], **options(request))
                problem = refused.value.problem
                found = (problem.status, problem.type, refused.value.pointer)
                assert found == (expected["status"], expected["type"], expected["instance_pointer"]), place
                return b""
            case {"array": name, "generation": generation, "dtype": dtype}:
                given: dict[str, Any] = {} if name == "tets" else {"dtype": dtype}
                query = f"?dtype={dtype}"
                if "from" in step:
                    given["start"] = step["from"]
                    query += f"&from={step['from']}"
                array = getattr(session, name)(generation, **given)
                assert array.dtype == np.dtype({"u32": "u4", "f32": "f4", "f64": "f8"}[dtype])
                path = f"v1/sessions/{session.id}/generations/{generation}/{name}"
                file = self.client.send(
                    "GET", path + ("" if name == "tets" else query), headers={"accept": "application/x-npy"}
                )
                assert array.tobytes() == bytes(file)[-array.nbytes :], place
                return entry(f"{name} {list(array.shape)}", array)
            case {"stitches": generation, "ids": ids, "pairs": pairs}:
                stitches = session.stitches(generation)
                assert stitches.ids.tolist() == ids and stitches.pairs.tolist() == pairs, place
                return b""
            case {"evaluate": generation, "q": q}:
                here = session.evaluate(q, generation=generation)
                return entry("evaluation", [here.energy_j], here.force, here.stiffness)
        raise AssertionError(f"{place}: no such step")


def options(request: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in request.items() if name != "edits"}


def test_the_cases_of_every_client(client: sutura.Client) -> None:
    received = []
    for number, case in enumerate(CASES):
        run = Run(client, case)
        for at, step in enumerate(case["steps"]):
            place = f"{case['name']}, step {at}"
            received.append(f"{number}.{at} ".encode() + run.step(step, place))
        run.session.delete()
    everything = b"".join(received)
    assert len(everything) > 1_000_000
    if folder := os.environ.get("SUTURA_CONFORMANCE"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / "python").write_bytes(everything)
