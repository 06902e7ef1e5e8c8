"""Numbers that decide something, and how many of them say where they come from.

``python -m benchmarks.thresholds`` counts them in the rooms that have most, ``--list`` names those
without a reason. Counted are named numbers (constants of a module, defaults of a dataclass) and
fractions within functions; not 0, 1, 2, one half, guards against a division by zero, or the file
that draws charts. A reason is a measurement, a benchmark, a paper, what would happen otherwise, or
the admission that it was chosen; in the comment at the number, in the comment above it, or in the
docstring where it is an attribute.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "napari_deltamic"
ROOMS = ("fitting", "evidence", "tracking", "geometry", "measure", "accuracy")
DRAWN = "log_chart.py"  # decides how something looks only
PLAIN = {0, 1, 2, 0.5, -1}
REASON = re.compile(
    r"[Mm]easured|[Cc]hosen|benchmark|docs/|paper|prototype|criterion|standard normal"
    r"|\b(19|20)\d\d\b"
    r"|so that|\belse\b|otherwise|would|could|since|because|hardly|rounding"
    r"|\bseen\b|found|\bthan\b|enough|only|limits? of|definition|exact|whose|told|cannot|no use"
    r"|precision|as [\w.]+ does"
)


@dataclass(frozen=True)
class Number:
    """place : file and line. text : as it stands there. explained : whether it has a reason."""

    place: str
    text: str
    explained: bool


def numbers(path: Path) -> Iterator[Number]:
    """Those of a file."""
    source = path.read_text(encoding="utf-8")
    lines = source.splitlines()
    for node, said in _literals(ast.parse(source)):
        if not _decides(node.value):
            continue
        where = f"{path.relative_to(PACKAGE)}:{node.lineno}"
        text = " ".join([said, _comments(lines, node.lineno)])
        explained = bool(REASON.search(text)) or ": " in said  # what it is: why
        yield Number(where, lines[node.lineno - 1].strip(), explained)


def _literals(tree: ast.Module) -> Iterator[tuple[ast.Constant, str]]:
    """Named numbers and fractions, each with what a docstring says of its name."""
    for statement in tree.body:
        if isinstance(statement, (ast.Assign, ast.AnnAssign)):
            for node in _constants(statement):
                yield node, ""
        elif isinstance(statement, ast.ClassDef):
            said = ast.get_docstring(statement) or ""
            for part in statement.body:
                if isinstance(part, (ast.Assign, ast.AnnAssign)):
                    name = part.target if isinstance(part, ast.AnnAssign) else part.targets[0]
                    own = _attribute(said, getattr(name, "id", ""))
                    for node in _constants(part):
                        yield node, own
                else:
                    yield from _within(part)
        elif isinstance(statement, ast.FunctionDef):
            yield from _within(statement)


def _within(function: ast.AST) -> Iterator[tuple[ast.Constant, str]]:
    for node in _constants(function):
        if isinstance(node.value, float) and not node.value.is_integer():
            yield node, ""


def _constants(tree: ast.AST) -> Iterator[ast.Constant]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node


def _decides(value: object) -> bool:
    assert isinstance(value, (int, float))
    return value not in PLAIN and not 0 < abs(value) <= 1e-12 and abs(value) < 1e9


def _comments(lines: list[str], number: int) -> str:
    """At the end of a line, and in the comment that stands above its block."""
    found = [lines[number - 1].partition("#")[2]]
    above = number - 2
    while above >= 0 and re.match(r"\s*(_?[A-Z][A-Z0-9_]*\b.*=|#|\d)", lines[above]):
        if lines[above].lstrip().startswith("#"):
            found.append(lines[above])
            if above and not lines[above - 1].lstrip().startswith("#"):
                break
        above -= 1
    below = number
    while below < len(lines) and lines[below].startswith("#"):
        found.append(lines[below])
        below += 1
    return " ".join(found)


def _attribute(docstring: str, name: str) -> str:
    """What a docstring says of an attribute."""
    found = re.search(rf"^(?:\w+, )*{name}(?:, \w+)*\n((?:    .*\n?|\n)*)", docstring, re.M)
    short = re.search(rf"^{name} : (.*)$", docstring, re.M)
    return " ".join(m.group(0) for m in (found, short) if m) if name else ""


def main(arguments: list[str] | None = None) -> None:
    """Prints a line a room."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.thresholds", description=__doc__)
    parser.add_argument("rooms", nargs="*", default=ROOMS)
    parser.add_argument("--list", action="store_true")
    chosen = parser.parse_args(arguments)
    for room in chosen.rooms:
        files = (f for f in sorted((PACKAGE / room).rglob("*.py")) if f.name != DRAWN)
        found = [number for file in files for number in numbers(file)]
        left = [n for n in found if not n.explained]
        print(f"{room}: {len(left)} of {len(found)} numbers without a reason")
        if chosen.list:
            print("\n".join(f"  {n.place}: {n.text}" for n in left))


if __name__ == "__main__":
    main()
