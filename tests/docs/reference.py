"""Makes docs/api.md of the daemon's /openapi.json and docs/command-line.md of its help.

python tests/docs/reference.py          compares them with what they should be
python tests/docs/reference.py --write  writes them
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import urllib.request
from typing import Any

from scenario import EXECUTABLE, ROOT

Schema = dict[str, Any]

API_HEADER = """# HTTP reference

Made of the daemon's own description by `tests/docs/reference.py`: not to be edited by hand. A running
daemon has the same, for programs, at `/openapi.json`.

Every answer carries `x-request-id`. Errors are [problem documents](#problem). Arrays are little-endian
and row-major, as `application/x-npy` or `application/vnd.sutura.frame`, whichever `Accept` asks for.
`{generation}` is a number or `current`. With keys, every request shows one as `Authorization: Bearer`.
"""

COMMAND_LINE_HEADER = """# Command line reference

Made of the help of each command by `tests/docs/reference.py`: not to be edited by hand.
"""


def described() -> Schema:
    """The daemon's description of its interface."""
    flags = ["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0", "--data", "none", "--log", "error"]
    with subprocess.Popen([EXECUTABLE, *flags], stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            address = next(line.split()[1] for line in daemon.stdout if line.startswith("http "))
            with urllib.request.urlopen(f"{address.rstrip('/')}/openapi.json", timeout=60) as answer:
                document: Schema = json.load(answer)
                return document
        finally:
            daemon.kill()


def anchor(heading: str) -> str:
    """The name under which a heading can be linked to, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def link(reference: str) -> str:
    name = reference.rsplit("/", 1)[1]
    return f"[`{name}`](#{anchor(name)})"


def kind(schema: Schema) -> str:
    """What a value is, in a few words."""
    if "$ref" in schema:
        return link(schema["$ref"])
    for choice in ("oneOf", "anyOf"):
        if choice in schema:
            return " or ".join(dict.fromkeys(kind(one) for one in schema[choice]))
    if "allOf" in schema:
        return " and ".join(kind(one) for one in schema["allOf"])
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    types = schema.get("type", [])
    names = [types] if isinstance(types, str) else types
    words = []
    for name in names:
        if name == "array":
            items = schema.get("items")
            several = (
                kind(items) if isinstance(items, dict) else ", ".join(map(kind, schema.get("prefixItems", [])))
            )
            words.append(f"array of {several}" if several else "array")
        elif name == "object" and isinstance(schema.get("additionalProperties"), dict):
            words.append(f"object of {kind(schema['additionalProperties'])}")
        else:
            words.append(name)
    return " or ".join(words) or "any value"


def cell(text: str) -> str:
    """Text for a table: on one line, and without the brackets of links within the code."""
    plain = re.sub(r"\[(`[^`]+`)\](?!\()", r"\1", text)
    return " ".join(plain.split()).replace("|", "\\|")


def members(schema: Schema) -> list[str]:
    """A table of the members of an object."""
    required = set(schema.get("required", []))
    rows = ["| member | type | |", "|---|---|---|"]
    for name, member in schema.get("properties", {}).items():
        said = [member.get("description", "")]
        if name not in required:
            said.append("*Optional.*")
        rows.append(f"| `{name}` | {cell(kind(member))} | {cell(' '.join(said))} |")
    return rows


def schema_section(name: str, schema: Schema) -> list[str]:
    lines = [f"### {name}", ""]
    if description := schema.get("description"):
        lines += [re.sub(r"\[(`[^`]+`)\](?!\()", r"\1", description), ""]
    for part in schema.get("allOf", [schema]):
        choices = part.get("oneOf")
        if choices is None:
            lines += [*members(part), ""] if part.get("properties") else [f"{kind(part).capitalize()}.", ""]
            continue
        rows = ["| one of | members | |", "|---|---|---|"]
        for choice in choices:
            inner = choice.get("properties", {})
            shown = ", ".join(f"`{member}`: {kind(value)}" for member, value in tagged(inner))
            head = ", ".join(f"`{member}`" for member in inner) or kind(choice)
            tags = [value["enum"][0] for value in inner.values() if len(value.get("enum", [])) == 1]
            said = [f"`{tags[0]}`" if tags else head, shown, choice.get("description", "")]
            rows.append(f"| {' | '.join(map(cell, said))} |")
        lines += [*rows, ""]
    return lines


def tagged(properties: Schema) -> list[tuple[str, Schema]]:
    """The members of a choice; of one that is named by its only member, those within."""
    values = list(properties.items())
    if len(values) == 1 and values[0][1].get("properties"):
        values = list(values[0][1]["properties"].items())
    return [(name, value) for name, value in values if len(value.get("enum", [])) != 1]


def content(content_of: Schema) -> str:
    said = []
    for media_type, value in content_of.items():
        schema = value.get("schema", {})
        is_bytes = schema.get("format") == "binary"
        said.append(f"`{media_type}`" if is_bytes else f"{kind(schema)} (`{media_type}`)")
    return ", ".join(said)


def operation_section(method: str, path: str, operation: Schema) -> list[str]:
    lines = [f"### {method.upper()} {path}", "", f"{operation['summary']}.", ""]
    queries = [one for one in operation.get("parameters", []) if one["in"] == "query"]
    if queries:
        lines += ["| query | |", "|---|---|"]
        lines += [f"| `{one['name']}` | {cell(one.get('description', ''))} |" for one in queries]
        lines.append("")
    if body := operation.get("requestBody"):
        lines += [f"Takes {content(body['content'])}.", ""]
    problems = []
    for status, response in operation["responses"].items():
        held = response.get("content", {})
        if "application/problem+json" in held:
            problems.append(f"{status} ({response['description'].lower()})")
        elif held:
            lines += [f"Answers {status}: {content(held)}.", ""]
        else:
            lines += [f"Answers {status}.", ""]
    if problems:
        lines += [f"Problems: {', '.join(problems)}.", ""]
    return lines


def api(document: Schema) -> str:
    """docs/api.md."""
    operations = [
        (method, path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    lines = [API_HEADER, "| | |", "|---|---|"]
    for method, path, operation in operations:
        heading = f"{method.upper()} {path}"
        lines.append(f"| [`{heading}`](#{anchor(heading)}) | {cell(operation['summary'])} |")
    lines += ["", "## Routes", ""]
    for operation in operations:
        lines += operation_section(*operation)
    lines += ["## Documents", ""]
    for name, schema in document["components"]["schemas"].items():
        lines += schema_section(name, schema)
    return "\n".join(lines).rstrip() + "\n"


def help_of(*command: str) -> str:
    # Environment variables show in the help with their values.
    env = {name: value for name, value in os.environ.items() if not name.startswith("SUTURA_")}
    run = subprocess.run([EXECUTABLE, *command, "--help"], capture_output=True, text=True, check=True, env=env)
    return "\n".join(line.rstrip() for line in run.stdout.rstrip().splitlines())


def command_line() -> str:
    """docs/command-line.md."""
    overview = help_of()
    parts = [COMMAND_LINE_HEADER, "## sutura", "", "```text", overview, "```", ""]
    listed = re.search(r"^Commands:\n((?:  .*\n)+)", overview, re.MULTILINE)
    assert listed is not None
    for name in re.findall(r"^  (\w[\w-]*)", listed[1], re.MULTILINE):
        if name != "help":
            parts += [f"## sutura {name}", "", "```text", help_of(name), "```", ""]
    return "\n".join(parts).rstrip() + "\n"


def main() -> int:
    pages = {"api.md": api(described()), "command-line.md": command_line()}
    stale = []
    for name, text in pages.items():
        path = ROOT / "docs" / name
        if "--write" in sys.argv[1:]:
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            stale.append(name)
    if stale:
        print(f"not current in docs/: {', '.join(stale)}; run python tests/docs/reference.py --write")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
