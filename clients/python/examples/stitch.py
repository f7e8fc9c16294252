"""Opens a session on a mesh, lets it sag, stitches its incision in mid-motion, and films it."""

import json
import sys
from pathlib import Path

import sutura
from sutura.plot import Film

mesh, case, film_path = sys.argv[1:4]  # stomach_small.msh stomach_small.json film.gif
described = json.loads(Path(case).read_text())
config = {name: described[name] for name in ("domain_materials", "fixed_vertices")}
pairs = described["stitches"]

client = sutura.Client()
session = client.create(mesh, config=config, seams=pairs, progress=True)
print("before:", session.info().frequencies_hz[:3], "Hz")
session.simulate(gravity_m_s2=(0.0, -9.81, 0.0), publish_hz=30.0)
tracker = sutura.Tracker(session)
with session.states() as states, Film(film_path, session) as film:
    for state in states:
        film.add(tracker.displacement(state))
        if film.n_frames == 15:
            reply = session.stitch(pairs, stiffness_n_m=1e5)
            print("after: ", reply.frequencies_hz[:3], "Hz")
        if film.n_frames == 45:
            break
session.delete()
