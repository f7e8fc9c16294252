"""The blocks of one Markdown file, run in their order as a reader would: in one shell, one interpreter and
one folder that looks like a clone, with what is to run in the background (the daemon) on free ports."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from blocks import Block, DocumentError
from shapes import documented, mismatch, text_matches

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
EXECUTABLE = Path(os.environ.get("SUTURA_EXECUTABLE", TARGET / "debug/sutura")).resolve()
WEB = ROOT / "clients/web"
PATIENCE_S = 300

# The documentation runs the release build out of a clone; here the executable is built already.
CARGO = """#!/bin/sh
if [ "$1 $2 $3" = "run --release --" ]; then shift 3; exec sutura "$@"; fi
echo "the documentation's runner knows cargo run --release -- alone, not: cargo $*" >&2; exit 1
"""
SERVING = re.compile(r"^http http://")


class Scenario:
    """Where one file's blocks are run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._clone()
        ports = free_ports(2)
        self._addresses = {"127.0.0.1:8080": f"127.0.0.1:{ports[0]}", "127.0.0.1:7447": f"127.0.0.1:{ports[1]}"}
        self._env = {
            **os.environ,
            "PATH": f"{folder / '.bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "SUTURA_HTTP": f"127.0.0.1:{ports[0]}",
            "SUTURA_ZENOH": f"tcp/127.0.0.1:{ports[1]}",
            "SUTURA_SERVER": f"http://127.0.0.1:{ports[0]}",
            "SUTURA_LOG": "warn",
            "PYVISTA_OFF_SCREEN": "true",
        }
        self._state = folder / ".bin/state"
        self._state.write_text(f"cd '{folder}'\n")
        self._background: subprocess.Popen[str] | None = None
        self._drain: threading.Thread | None = None
        self._python: subprocess.Popen[str] | None = None
        self._printed: str | None = None
        self._program: list[Block] = []

    def _clone(self) -> None:
        for entry in ROOT.iterdir():
            if entry.name not in {".git", "target"}:
                (self.folder / entry.name).symlink_to(entry)
        programs = self.folder / ".bin"
        programs.mkdir()
        (programs / "sutura").symlink_to(EXECUTABLE)
        (programs / "cargo").write_text(CARGO)
        (programs / "cargo").chmod(0o755)

    def run(self, blocks: list[Block]) -> tuple[int, list[str]]:
        """Runs `blocks`; how many, and why the others were left out. Raises `DocumentError`."""
        n_run, left_out = 0, []
        for at, block in enumerate(blocks):
            if "not run" in block.directives:
                reason = block.directives["not run"]
                if len(reason) < 8:
                    raise DocumentError(f"{block.place}: `not run` needs a reason")
                left_out.append(f"{block.place}: {reason}")
                self._printed = None
                continue
            following = blocks[at + 1].language if at + 1 < len(blocks) else ""
            self._run(block, following)
            n_run += 1
        return n_run, left_out

    def _run(self, block: Block, following: str) -> None:
        if "file" in block.directives and block.language not in {"rust", "js"}:
            self._write(block)
            return
        match block.language:
            case "sh" if "background" in block.directives:
                self._start(block)
            case "sh":
                self._printed = self._shell(block)
            case "python":
                self._printed = self._exec(block)
            case "json":
                self._compare_json(block)
            case "text":
                self._compare_text(block)
            case "toml":
                self._check_configuration(block)
            case "rust" | "js" | "ts" as language:
                # A program may be told in pieces: it is run at its last one.
                self._program.append(block)
                if following != language:
                    pieces, self._program = self._program, []
                    run = {"rust": self._rust, "js": self._javascript, "ts": self._typescript}[language]
                    self._printed = run(pieces)
            case language:
                raise DocumentError(f"{block.place}: nothing runs blocks of language `{language}`")

    def _here(self, code: str) -> str:
        for shown, actual in self._addresses.items():
            code = code.replace(shown, actual)
        return code

    def _write(self, block: Block) -> None:
        name = block.directives["file"]
        if not re.fullmatch(r"[\w.-]+", name):
            raise DocumentError(f"{block.place}: {name!r} is no file name")
        if block.language == "json":
            self._parse(block)
        if block.language == "toml":
            self._check_configuration(block)
        (self.folder / name).write_text(self._here(block.code))

    def _shell(self, block: Block) -> str:
        # What a block sets is there for the next one.
        script = f". '{self._state}'\nset -a\n{self._here(block.code)}"
        save = f"{{ export -p; printf 'cd %q\\n' \"$PWD\"; }} > '{self._state}'"
        expected = int(block.directives.get("fails", "0"))
        command = ["bash", "-euo", "pipefail", "-c", f'trap "{escape(save)}" EXIT\n{script}']
        return self._command(block, command, self.folder, expected)

    def _popen(
        self, command: list[str], folder: Path, *, stdin: int, stderr: int | None = None
    ) -> subprocess.Popen[str]:
        return subprocess.Popen(
            command,
            cwd=folder,
            env=self._env,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            start_new_session=True,
        )

    def _command(self, block: Block, command: list[str], folder: Path, expected: int = 0) -> str:
        process = self._popen(command, folder, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            printed, complaints = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            raise DocumentError(f"{block.place}: has not ended after {PATIENCE_S} s") from None
        if process.returncode != expected:
            raise DocumentError(
                f"{block.place}: ended with {process.returncode} instead of {expected}\n"
                f"{tail(printed)}{tail(complaints)}"
            )
        # A block that shows a failure shows its message.
        return printed + complaints if expected else printed

    def _start(self, block: Block) -> None:
        self._stop_background()
        script = f". '{self._state}'\n{self._here(block.code)}"
        process = self._popen(["bash", "-c", script], self.folder, stdin=subprocess.DEVNULL)
        self._background = process
        stop = threading.Timer(PATIENCE_S, process.kill)
        stop.start()
        assert process.stdout is not None
        serves = any(SERVING.match(line) for line in process.stdout)
        stop.cancel()
        if not serves:
            raise DocumentError(f"{block.place}: ended without serving")
        # What it goes on to print must not fill the pipe.
        self._drain = threading.Thread(target=process.stdout.read, daemon=True)
        self._drain.start()

    def _exec(self, block: Block) -> str:
        if self._python is None:
            command = [sys.executable, str(HERE / "interpreter.py")]
            self._python = self._popen(command, self.folder, stdin=subprocess.PIPE)
        process = self._python
        assert process.stdin is not None and process.stdout is not None
        stop = threading.Timer(PATIENCE_S, process.kill)
        stop.start()
        piece = {"code": self._here(block.code), "name": str(block.path), "line": block.line}
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(piece), file=process.stdin, flush=True)
        line = process.stdout.readline()
        stop.cancel()
        if not line:
            raise DocumentError(f"{block.place}: the interpreter has ended")
        answer: dict[str, Any] = json.loads(line)
        if answer["error"]:
            raise DocumentError(f"{block.place}: {answer['error']}")
        return str(answer["printed"])

    def _parse(self, block: Block) -> Any:
        try:
            return documented(block.code)
        except ValueError as error:
            raise DocumentError(f"{block.place}: no JSON: {error}") from None

    def _printed_before(self, block: Block) -> str:
        if self._printed is None:
            raise DocumentError(f"{block.place}: no block above has printed what this one shows")
        printed, self._printed = self._printed, None
        return printed

    def _compare_json(self, block: Block) -> None:
        printed = self._printed_before(block)
        try:
            found = json.loads(printed)
        except ValueError:
            raise DocumentError(f"{block.place}: the block above printed no JSON: {tail(printed)}") from None
        if problem := mismatch(self._parse(block), found):
            raise DocumentError(f"{block.place}: {problem}")

    def _compare_text(self, block: Block) -> None:
        printed = self._printed_before(block)
        for shown, actual in self._addresses.items():
            printed = printed.replace(actual, shown)
        if not text_matches(block.code, printed):
            raise DocumentError(f"{block.place}: the block above printed:\n{tail(printed)}")

    def _check_configuration(self, block: Block) -> None:
        path = self.folder / ".bin/checked.toml"
        path.write_text(block.code)
        command = [str(EXECUTABLE), "doctor", "--json", "--config", str(path)]
        run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        # 1 is a machine that is not fit, such as one whose ports are taken: no fault of the block's.
        if run.returncode not in {0, 1}:
            raise DocumentError(f"{block.place}: {run.stderr}")

    def _rust(self, pieces: list[Block]) -> str:
        """Pieces of an example of the Rust client, which the build has compiled."""
        path = self._same_as_file(pieces)
        data = [f"tests/data/stomach_small.{ending}" for ending in ("msh", "json")]
        program = str(TARGET / "debug/examples" / path.stem)
        return self._command(pieces[0], [program, self._env["SUTURA_SERVER"], *data], self.folder)

    def _javascript(self, pieces: list[Block]) -> str:
        path = self._same_as_file(pieces)
        data = [f"tests/data/stomach_small.{ending}" for ending in ("msh", "json")]
        command = ["node", "--experimental-websocket", str(path), self._env["SUTURA_SERVER"], *data]
        return self._command(pieces[0], command, self.folder)

    def _same_as_file(self, pieces: list[Block]) -> Path:
        """The file that the pieces, one after the other, are."""
        name = pieces[0].directives.get("file")
        if name is None:
            raise DocumentError(f"{pieces[0].place}: `file` names the file that this is")
        shown = [(piece, at, line) for piece in pieces for at, line in enumerate(piece.code.splitlines())]
        shown = [(piece, at, line.strip()) for piece, at, line in shown if line.strip()]
        path = ROOT / name
        lines = [line.strip() for line in path.read_text().splitlines() if line.strip()]
        for (piece, at, line), actual in zip(shown, lines, strict=False):
            if line != actual:
                place = f"{piece.path}:{piece.line + at}"
                raise DocumentError(f"{place}: `{line}`, where {name} has `{actual}`")
        if len(shown) != len(lines):
            raise DocumentError(f"{pieces[0].place}: {len(shown)} lines, where {name} has {len(lines)}")
        return path

    def _typescript(self, pieces: list[Block]) -> str:
        folder = self.folder / ".bin/typescript"
        (folder / "node_modules").mkdir(parents=True)
        (folder / "node_modules/sutura").symlink_to(WEB)
        (folder / "package.json").write_text('{"type": "module"}')
        (folder / "program.ts").write_text(self._here("".join(piece.code for piece in pieces)))
        options = {
            "compilerOptions": {
                "module": "nodenext",
                "target": "es2022",
                "lib": ["es2023", "dom", "dom.iterable"],
                "strict": True,
                "skipLibCheck": True,
                "types": ["node"],
                "typeRoots": [str(WEB / "node_modules/@types")],
            },
            "files": ["program.ts"],
        }
        (folder / "tsconfig.json").write_text(json.dumps(options))
        self._command(pieces[0], ["node", str(WEB / "node_modules/typescript/bin/tsc"), "-p", "."], folder)
        program = str(folder / "program.js")
        return self._command(pieces[0], ["node", "--experimental-websocket", program], self.folder)

    def _stop_background(self) -> None:
        if self._background is not None:
            end(self._background, self._drain)
            self._background = None

    def close(self) -> None:
        """Ends what still runs."""
        self._stop_background()
        if self._python is not None:
            end(self._python)


@contextlib.contextmanager
def scenario() -> Iterator[Scenario]:
    """A scenario in a scratch folder."""
    folder = Path(tempfile.mkdtemp(prefix="sutura-docs-"))
    started = None
    try:
        started = Scenario(folder)
        yield started
    finally:
        if started is not None:
            started.close()
        shutil.rmtree(folder, ignore_errors=True)


def end(process: subprocess.Popen[str], reader: threading.Thread | None = None) -> None:
    """Ends a process and those that it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(timeout=30)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    if reader is not None:
        reader.join(timeout=30)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


def free_ports(n: int) -> list[int]:
    """Ports that nobody listens on now."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(n)]
    ports = [listening.getsockname()[1] for listening in sockets]
    for listening in sockets:
        listening.close()
    return ports


def escape(text: str) -> str:
    return re.sub(r'(["\\$`])', r"\\\1", text)


def tail(text: str) -> str:
    return "\n".join(text.splitlines()[-30:]) + "\n" if text else ""
