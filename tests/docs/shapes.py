"""Whether an answer is what the documentation says, but for the numbers.

Documented JSON may leave out what follows in an array (`[1, 2, …]`), the rest of a text
(`"the basis has …"`), a whole value (`…`, `{…}`) and the rest of an object (`"…": …`). Everything else has to
be there: the same keys, kinds, texts and truth values. Numbers are compared by kind alone, identifiers
by form.
"""

from __future__ import annotations

import json
import re
from typing import Any

ELLIPSIS = "…"
IDENTIFIER = re.compile(r"\b(?:[0-9a-f]{32}|[0-9a-f]{12})\b")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|…')


def documented(text: str) -> Any:
    """The JSON that the documentation shows, `…` become texts of that one character."""
    bare = text.replace("{…}", f'"{ELLIPSIS}"').replace("[…]", f'"{ELLIPSIS}"')
    quoted = TOKEN.sub(lambda token: token[0] if token[0] != ELLIPSIS else f'"{ELLIPSIS}"', bare)
    return json.loads(quoted)


def mismatch(shown: Any, found: Any, at: str = "") -> str | None:
    """Where and why the answer `found` is not as `shown`, or None."""
    place = at or "/"
    if shown == ELLIPSIS:
        return None
    if isinstance(shown, bool) or isinstance(found, bool) or shown is None or found is None:
        return None if shown is found else f"{place}: {found!r} instead of {shown!r}"
    if isinstance(shown, (int, float)):
        return None if isinstance(found, (int, float)) else f"{place}: {found!r} is no number"
    if isinstance(shown, str):
        if not isinstance(found, str):
            return f"{place}: {found!r} is no text"
        return None if text_matches(shown, found) else f"{place}: {found!r} instead of {shown!r}"
    if isinstance(shown, list):
        if not isinstance(found, list):
            return f"{place}: {found!r} is no array"
        wanted = [value for value in shown if value != ELLIPSIS]
        is_open = len(wanted) < len(shown)
        if len(found) < len(wanted) or (len(found) > len(wanted) and not is_open):
            return f"{place}: {len(found)} elements instead of {len(wanted)}"
        pairs = zip(wanted, found, strict=False)
        return first(mismatch(a, b, f"{at}/{i}") for i, (a, b) in enumerate(pairs))
    if not isinstance(found, dict):
        return f"{place}: {found!r} is no object"
    is_open = ELLIPSIS in shown
    wanted = {key: value for key, value in shown.items() if key != ELLIPSIS}
    if missing := wanted.keys() - found.keys():
        return f"{place}: the answer has no {sorted(missing)}"
    if not is_open and (more := found.keys() - wanted.keys()):
        return f"{place}: the documentation does not show {sorted(more)}"
    return first(mismatch(value, found[key], f"{at}/{key}") for key, value in wanted.items())


def text_matches(shown: str, found: str) -> bool:
    """Whether texts agree but for numbers, identifiers and what `…` stands for."""

    def plain(text: str) -> str:
        return NUMBER.sub("0", IDENTIFIER.sub("0", text)).strip()

    def spaced(text: str) -> str:
        return "\n".join(" ".join(line.split()) for line in text.splitlines())

    parts = [re.escape(spaced(plain(part))) for part in shown.split(ELLIPSIS)]
    return re.fullmatch(r"\s*.*?\s*".join(parts), spaced(plain(found)), re.DOTALL) is not None


def first(problems: Any) -> str | None:
    return next((problem for problem in problems if problem is not None), None)
