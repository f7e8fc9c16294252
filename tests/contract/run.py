"""Schemathesis against a real daemon: whatever is sent, its answer is one that /openapi.json promises.

    python tests/contract/run.py EXECUTABLE [SECONDS]

First against a session that exists, so that requests get as far as its body; then, with identifiers of
Schemathesis' own, against what does not exist, deletion included. Needs `pip install schemathesis`.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

SEED = "1"
# What the answers are held against. Left out: that whatever the description allows is accepted (a vertex
# may be out of range of this mesh), and that nothing else is (a number out of range is refused, but so are
# members that the description does not bound).
CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
    "unsupported_method",
)
# These answer for as long as somebody listens.
STREAMS = ("/v1/sessions/{id}/events", "/v1/sessions/{id}/stream")

# Two cubes, one upon the other, that touch in four pairs of vertices.
SESSION = {
    "name": "contract",
    "material": {"law": "stvk", "young_modulus_pa": 5e5, "poisson_ratio": 0.4, "density_kg_m3": 1000},
    "mesh": {
        "vertices": [[i, j, k + z] for z in (0, 1) for k in (0, 1) for j in (0, 1) for i in (0, 1)],
        "tets": [
            [8 * cube + corner for corner in tet]
            for cube in (0, 1)
            for tet in ((0, 1, 3, 7), (0, 5, 1, 7), (0, 4, 5, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7))
        ],
        "domains": [1] * 6 + [2] * 6,
    },
    "fixed_vertices": [0, 1, 2, 3],
    "n_modes": 4,
    "basis": {"size": 6, "n_derivative_modes": 2},
    "cubature": {"n_points": 3, "n_training_poses": 5},
    "seams": [[4, 8], [5, 9], [6, 10], [7, 11]],
}


def post(url: str, document: object) -> dict:
    request = urllib.request.Request(
        url, json.dumps(document).encode(), {"content-type": "application/json"}, method="POST"
    )
    with urllib.request.urlopen(request, timeout=60) as response:
        return json.load(response)


def schemathesis(url: str, seconds: int, config: str, arguments: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "schemathesis.toml"
        path.write_text(config)
        command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(path), "run"]
        command += [f"{url}/openapi.json", "--seed", SEED, "--max-time", str(seconds)]
        command += ["--generation-database", "none", "--continue-on-failure", "--request-timeout", "30"]
        command += ["--checks", ",".join(CHECKS), "--phases", "examples,coverage,fuzzing"]
        for path in STREAMS:
            command += ["--exclude-path", path]
        subprocess.run(command + arguments, check=True, cwd=folder)


def main() -> None:
    executable, seconds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 45
    command = [executable, "serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0", "--data", "none"]
    daemon = subprocess.Popen([*command, "--log", "warn"], stdout=subprocess.PIPE, text=True)
    try:
        assert daemon.stdout is not None
        url = daemon.stdout.readline().split()[1]
        session = post(f"{url}/v1/sessions?wait_s=30", SESSION)
        assert session["state"] == "ready", session
        stitch = {"stitch": {"pairs": SESSION["seams"], "stiffness_n_m": 1e5}}
        post(f"{url}/v1/sessions/{session['id']}/edits", {"edits": [stitch]})
        known = f'[parameters]\nid = "{session["id"]}"\n'
        schemathesis(url, seconds, known, ["--exclude-method", "DELETE", "--max-examples", "60"])
        schemathesis(url, max(seconds // 3, 1), "", ["--max-examples", "15"])
        # It still works. (That session may be gone: its identifier can be found in the list, and deleted.)
        another = post(f"{url}/v1/sessions?wait_s=30", {**SESSION, "name": "afterwards"})
        assert another["state"] == "ready", another
        assert daemon.poll() is None
    finally:
        daemon.terminate()
        daemon.wait(60)


if __name__ == "__main__":
    begun = time.monotonic()
    main()
    print(f"the answers are those of the description ({time.monotonic() - begun:.0f} s)")
