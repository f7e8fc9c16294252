"""Runs pieces of Python one after the other in one namespace: JSON lines in, JSON lines out."""

import contextlib
import io
import json
import os
import sys
import traceback

answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
namespace = {"__name__": "__main__"}
for line in sys.stdin:
    piece = json.loads(line)
    printed = io.StringIO()
    error = None
    try:
        # Empty lines ahead: tracebacks name the line of the Markdown file.
        code = compile("\n" * (piece["line"] - 1) + piece["code"], piece["name"], "exec")
        with contextlib.redirect_stdout(printed):
            exec(code, namespace)
    except BaseException:
        error = traceback.format_exc()
    print(json.dumps({"printed": printed.getvalue(), "error": error}), file=answers, flush=True)
