"""The fenced blocks of a Markdown file, with what stands about them in comments above."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^(?P<indent> *)```(?P<language>[\w+-]*) *$")
DIRECTIVE = re.compile(r"^ *<!-- *(?P<name>not run|background|file|fails)(?:: *(?P<value>.*?))? *-->$")


class DocumentError(Exception):
    """The documentation is wrong, and where."""


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    path: Path
    line: int
    """Of its first line of code, from 1."""
    language: str
    code: str
    directives: dict[str, str]

    @property
    def place(self) -> str:
        return f"{self.path}:{self.line}"


def blocks_of(path: Path) -> list[Block]:
    """The blocks of a Markdown file, in their order."""
    blocks: list[Block] = []
    directives: dict[str, str] = {}
    opened: tuple[str, str, int] | None = None
    code: list[str] = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        fence = FENCE.match(line)
        if opened is not None:
            indent, language, first = opened
            if line.strip() == "```":
                text = "\n".join(code) + "\n"
                blocks.append(Block(path, first, language, text, directives))
                opened, code, directives = None, [], {}
            else:
                code.append(line.removeprefix(indent))
        elif fence:
            opened = (fence["indent"], fence["language"], number + 1)
        elif directive := DIRECTIVE.match(line):
            directives[directive["name"]] = directive["value"] or ""
        elif line.strip():
            if directives:
                raise DocumentError(f"{path}:{number}: a directive stands above no block")
            if line.lstrip().startswith("```"):
                raise DocumentError(f"{path}:{number}: a fence that cannot be read: {line.strip()}")
    if opened is not None:
        raise DocumentError(f"{path}:{opened[2]}: the block does not end")
    return blocks
