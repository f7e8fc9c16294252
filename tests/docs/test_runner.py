"""The runner sees what is wrong: each of these documents is, in one place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from blocks import DocumentError
from run import check, check_links
from scenario import ROOT
from shapes import documented, mismatch, text_matches

GOOD = """
```sh
A=1; echo '{"a": 1.5, "b": [1, 2, 3], "c": "5 of 7", "d": true}' > x.json
cat x.json
```

```json
{"a": 2, "b": [3, …], "c": "1 of 2", "d": true}
```

```sh
[ "$A" = 1 ] && jq -c .b x.json
```

```text
[7,8,9]
```

```python
x = 3
```

```python
assert x == 3
print(f"{x} bodies")
```

```text
3 bodies
```

<!-- fails: 2 -->
```sh
sutura info --no-such-flag
```

```text
error: unexpected argument '--no-such-flag' found …
```

```toml
[http]
listen = "127.0.0.1:0"
```
"""


def outcome(tmp_path: Path, text: str) -> str:
    """What the runner says of a document: nothing, or what is wrong."""
    path = tmp_path / "page.md"
    path.write_text(text)
    try:
        check(path)
    except DocumentError as error:
        return str(error)
    return ""


def test_what_is_right_passes(tmp_path: Path) -> None:
    assert outcome(tmp_path, GOOD) == ""


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("cat x.json", "cat y.json", 3),
        ('"a": 2', '"a": "2"', 8),
        ('"a": 2, ', "", 8),
        ('"a": 2', '"a": 2, "e": 2', 8),
        ("[3, …]", "[3]", 8),
        ('"1 of 2"', '"1 or 2"', 8),
        ('"d": true}\n```\n\n```sh', '"d": false}\n```\n\n```sh', 8),
        ("[7,8,9]", "[7,8]", 16),
        ("assert x == 3", "assert x == 4", 24),
        ('print(f"{x} bodies")', "print(y)", 24),
        ("3 bodies\n", "3 organs\n", 29),
        ("--no-such-flag\n```\n\n```text", "--help\n```\n\n```text", 34),
        ("listen =", "hear =", 42),
        ("```toml", "```cobol", 42),
        ("```toml", "```", 42),
        ("```toml", "<!-- not run: -->\n```toml", 43),
    ],
)
def test_what_is_wrong_is_found_in_its_place(tmp_path: Path, right: str, wrong: str, line: int) -> None:
    assert GOOD.count(right) == 1
    assert f"page.md:{line}:" in outcome(tmp_path, GOOD.replace(right, wrong))


@pytest.mark.parametrize("text", ["Words.\n", "<!-- not run: it is for show -->\n```sh\nfalse\n```\n"])
def test_a_file_of_which_nothing_runs_is_refused(tmp_path: Path, text: str) -> None:
    assert "not one block was run" in outcome(tmp_path, text)


def test_pieces_that_are_not_their_file_are_refused(tmp_path: Path) -> None:
    text = "<!-- file: clients/rust/examples/stitch.rs -->\n```rust\nfn main() {}\n```\n"
    assert "page.md:3: `fn main() {}`" in outcome(tmp_path, text)


def test_types_are_checked(tmp_path: Path) -> None:
    text = "```ts\nimport { Client } from 'sutura'\nnew Client(3)\n```\n"
    assert "page.md:2: ended with 2" in outcome(tmp_path, text)


def test_shapes() -> None:
    assert mismatch(documented('{"a": 1, "…": …}'), {"a": 2, "b": 3}) is None
    assert mismatch(documented('{"a": {…}, "b": "x …"}'), {"a": [], "b": "x y"}) is None
    assert mismatch(documented('{"a": [{"b": 1}, …]}'), {"a": [{"c": 1}]}) == "/a/0: the answer has no ['b']"
    assert mismatch([1, 2], [1, True]) == "/1: True instead of 2"
    assert text_matches(
        "id 01a203b4313b74eaa8a1ddc71abf859b at 3", "id 55a203b4313b74eaa8a1ddc71abf8500 at 4.5e3"
    )
    assert not text_matches("one …", "two")


def test_links_are_followed(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text("# A *b* c\n\n[here](#a-b-c), [there](https://sutura.invalid), [page](page.md#a-b-c)\n")
    check_links(path)
    for wrong in ("other.md", "#a-b", "page.md#d"):
        path.write_text(f"# A b c\n\n[x]({wrong})\n")
        with pytest.raises(DocumentError):
            check_links(path)


def test_every_problem_is_explained() -> None:
    table = (ROOT / "src/transport/problem.rs").read_text()
    kinds = re.findall(r"\((\d{3}), \"([a-z-]+)\", \"", table)
    assert len(kinds) > 25
    explained = (ROOT / "docs/operations.md").read_text()
    assert [kind for kind in kinds if f"| {kind[0]} | `{kind[1]}` |" not in explained] == []
