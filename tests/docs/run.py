"""Runs every code block of the documentation against a real daemon: python tests/docs/run.py [FILE …].

Each Markdown file is a scenario of its own. Blocks in `sh` and `python` run in order, `rust`, `js` and `ts` as
programs; `json` and `text` below them are compared with what they printed; `toml` is read by the daemon.
Comments above a block say what is particular about it:

    <!-- background -->          it goes on running (the daemon) until the file ends or the next such block
    <!-- file: NAME -->          it is written to that file; `rust` and `js`: it is that file of the repository
    <!-- fails: 2 -->            it ends with that exit code
    <!-- not run: REASON -->     it cannot be run here
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

from blocks import DocumentError, blocks_of
from reference import anchor
from scenario import EXECUTABLE, ROOT, scenario

# Made by tests/docs/reference.py, which has a check of its own.
GENERATED = {"api.md", "command-line.md"}


def documents() -> list[Path]:
    """Every Markdown file that has blocks to be run."""
    folders = [ROOT / "clients/python", ROOT / "clients/web"]
    pages = [page for page in sorted((ROOT / "docs").glob("*.md")) if page.name not in GENERATED]
    return [ROOT / "README.md", *pages, *(folder / "README.md" for folder in folders)]


def check(path: Path) -> tuple[int, list[str]]:
    """Runs the blocks of a file; how many, and why the others were left out."""
    blocks = blocks_of(path)
    with scenario() as here:
        n_run, left_out = here.run(blocks)
    if n_run == 0:
        raise DocumentError(f"{path}: not one block was run")
    return n_run, left_out


def check_links(path: Path) -> None:
    """That every file and heading that a page links to is there."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, heading = target.partition("#")
        if "://" in target:
            continue
        linked = (path.parent / name).resolve() if name else path
        if not linked.exists():
            raise DocumentError(f"{path}: links to {target}, which is not there")
        if heading and linked.suffix == ".md":
            headings = re.findall(r"^#+ +(.+)$", linked.read_text(), re.MULTILINE)
            if heading not in {anchor(one) for one in headings}:
                raise DocumentError(f"{path}: {linked.name} has no heading {heading}")


def main(paths: list[Path]) -> int:
    if not EXECUTABLE.exists():
        print(f"{EXECUTABLE} is not there: cargo build", file=sys.stderr)
        return 1
    n_failed = n_run = n_left_out = 0
    for path in paths or documents():
        start = time.monotonic()
        try:
            check_links(path)
            n, left_out = check(path)
        except DocumentError as error:
            n_failed += 1
            print(f"FAILED {error}", flush=True)
            continue
        n_run += n
        n_left_out += len(left_out)
        shown = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
        print(f"{shown}: {n} blocks run in {time.monotonic() - start:.0f} s", flush=True)
        for reason in left_out:
            print(f"    not run: {reason}")
    print(f"{n_run} blocks run, {n_left_out} not, {n_failed} files failed")
    return 1 if n_failed else 0


if __name__ == "__main__":
    sys.exit(main([Path(name).resolve() for name in sys.argv[1:]]))
