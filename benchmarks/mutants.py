"""Mutation test: which small changes of the code does no test notice?

    python -m benchmarks.mutants list                        the mutants: number, file, line, change
    python -m benchmarks.mutants run -- tests/variants       run these tests on each mutant
    python -m benchmarks.mutants run --only 3,7 --together   all chosen mutants in one run: if it passes, none
                                                             of them is noticed

NAMED are changes that readers made by hand. The others are drawn at random, with a seed: an operator or a
number in an expression of fmus/components, orchestrator/engine (Python and C) or fmus/identification. Some of
them change nothing that can be observed. The tests run in a copy of the last commit, and stop at the first
failure.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
SEED = 34
# folder -> (how many mutants, files)
PLACES = {
    "fmus/components": (13, ("*.py",)),
    "orchestrator/engine": (14, ("*.py", "native/*.c")),
    "fmus/identification": (13, ("**/*.py",)),
}
SWAPPED = {
    **{"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*", "@": "*"},
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="},
    **{"is": "is not", "is not": "is", "in": "not in", "not in": "in"},
    **{"and": "or", "or": "and", "&&": "||", "||": "&&", "&": "|", "|": "&", "<<": ">>", ">>": "<<"},
}
C_TOKEN = re.compile(
    r"(?<= )(?:[-+*/<>]|<=|>=|==|!=|&&|\|\|)(?= )"  # operators between blanks
    r"|(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])"
)
C_ASIDE = re.compile(r"/\*.*?\*/|//[^\n]*|^#[^\n]*|\"[^\"\n]*\"", re.DOTALL | re.MULTILINE)
NO_VALUES = ("annotation", "returns", "decorator_list", "bases")  # of a statement in Python


class Mutant(NamedTuple):
    """The text from `begin` to `end` of a file becomes `after`."""

    file: str
    begin: int
    end: int
    before: str
    after: str

    def text(self) -> str:
        """Its place and the change, with the rest of the line."""
        content = (ROOT / self.file).read_text(encoding="utf-8")
        start = content.rfind("\n", 0, self.begin) + 1
        number, stop = content.count("\n", 0, self.begin) + 1, content.find("\n", self.end)
        changed = content[start : self.begin] + f"[{self.before} -> {self.after}]" + content[self.end : stop]
        return f"{self.file}:{number}: {changed.strip()}"


# file, text, the text that takes its place
_NAMED = (
    ("orchestrator/engine/native/error_propagation.c", "line[0] = 2.0 / 3.0 *", "line[0] = 1.0 *"),
    ("orchestrator/engine/native/error_propagation.c", "d[1] * h * h / 12.0", "d[1] * h * h / 6.0"),
    ("orchestrator/engine/native/error_propagation.c", "fourth / 720.0", "fourth / 360.0"),
    ("orchestrator/engine/accuracy.py", "Experience(0.6,", "Experience(1.2,"),
    ("orchestrator/engine/accuracy.py", "INSIDE = 0.5", "INSIDE = 1.0"),
    ("orchestrator/engine/accuracy.py", "FMU_TOLERANCE = 3e-2", "FMU_TOLERANCE = 9e-2"),
    ("fmus/identification/procedures/weighing.py", "-= 1.0 / len(self.tares)", "-= 1.0"),
    ("fmus/identification/procedures/weighing.py", ".zero / 2", ".zero"),
    ("orchestrator/ssp/parameter_sets.py", "first.then(linear)", "linear.then(first)"),
)


def named() -> list[Mutant]:
    """The changes of readers."""
    found = []
    for file, before, after in _NAMED:
        content = (ROOT / file).read_text(encoding="utf-8")
        assert content.count(before) == 1, f"{file} has {content.count(before)} times {before!r}, expected 1"
        begin = content.index(before)
        found.append(Mutant(file, begin, begin + len(before), before, after))
    return found


def drawn() -> list[Mutant]:
    """The random ones: as many of each folder as PLACES tells."""
    found = []
    for folder, (count, patterns) in PLACES.items():
        files = sorted(path for pattern in patterns for path in (ROOT / folder).glob(pattern))
        every = [mutant for path in files for mutant in mutants_of(path)]
        found += sorted(random.Random(SEED).sample(every, count))
    return found


def mutants_of(path: Path) -> Iterator[Mutant]:
    """All mutants of one file."""
    name, content = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
    places = c_places(content) if path.suffix == ".c" else python_places(content)
    for begin, end, after in places:
        yield Mutant(name, begin, end, content[begin:end], after)


def number(text: str) -> str:
    """Another number: 0 becomes 1, a whole number one more, any other one and a half times as much."""
    return str(int(text) + 1) if text.isdigit() else repr(1.5 * float(text) or 1.0)


def c_places(content: str) -> Iterator[tuple[int, int, str]]:
    """Operators and numbers of C, but for comments and directives."""
    blank = C_ASIDE.sub(lambda aside: re.sub(r"[^\n]", "_", aside[0]), content)
    for found in C_TOKEN.finditer(blank):
        text = found[0]
        if text != "*" or re.search(r"[\w)\]] $", blank[: found.start()]):
            yield found.start(), found.end(), SWAPPED.get(text) or number(text)


def python_places(content: str) -> Iterator[tuple[int, int, str]]:
    """Operators and numbers of expressions, but for annotations and declared quantities."""
    lines = [0]
    for line in content.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    raw = content.split("\n")

    def at(line: int, column: int) -> int:
        return lines[line - 1] + len(raw[line - 1].encode()[:column].decode())

    def begin(node: ast.AST) -> int:
        return at(node.lineno, node.col_offset)  # type: ignore[attr-defined]

    def end(node: ast.AST) -> int:
        return at(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]

    def between(left: ast.AST, right: ast.AST) -> Iterator[tuple[int, int, str]]:
        """The operator between two operands, which may stand in parentheses."""
        text = content[end(left) : begin(right)]
        found = re.search(r"is not|not in|\*\*|//|<=|>=|==|!=|<<|>>|and|or|is|in|[-+*/%@<>&|^]", text)
        if found and "#" not in text:
            yield end(left) + found.start(), end(left) + found.end(), SWAPPED[found[0]]

    def visit(node: ast.AST) -> Iterator[tuple[int, int, str]]:
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Quantity":
            return
        if isinstance(node, ast.BinOp) and not isinstance(getattr(node.left, "value", 0), str):
            yield from between(node.left, node.right)
        elif isinstance(node, ast.Compare):
            yield from between(node.left, node.comparators[0])
        elif isinstance(node, ast.BoolOp):
            yield from between(*node.values[:2])
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield begin(node), end(node), number(content[begin(node) : end(node)].replace("_", ""))
        for name, field in ast.iter_fields(node):
            if name in NO_VALUES or (name == "keywords" and isinstance(node, ast.ClassDef)):
                continue
            for child in field if isinstance(field, list) else [field]:
                if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                    yield from visit(child)

    yield from visit(ast.parse(content))


def run(mutants: Sequence[tuple[int, Mutant]], tests: Sequence[str], place: Path) -> bool:
    """Do the tests fail with these mutants?"""
    saved = {m.file: (place / m.file).read_text(encoding="utf-8") for _, m in mutants}
    for _, mutant in sorted(mutants, key=lambda m: -m[1].begin):
        content = (place / mutant.file).read_text(encoding="utf-8")
        assert content[mutant.begin : mutant.end] == mutant.before
        changed = content[: mutant.begin] + mutant.after + content[mutant.end :]
        (place / mutant.file).write_text(changed, encoding="utf-8")
    began, label = time.monotonic(), ",".join(str(k) for k, _ in mutants)
    stop = [] if len(mutants) > 1 else ["-x"]
    # commands that the tests start import the copy, too
    environment = {**os.environ, "PYTHONPATH": str(place)}
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "worksteal", *stop, *tests]
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    for file, content in saved.items():
        (place / file).write_text(content, encoding="utf-8")
    failed = re.findall(r"^(?:FAILED|ERROR) (.*)$", done.stdout, re.M)
    noticed = done.returncode != 0
    if noticed and not failed:
        print(done.stdout[-2000:], done.stderr[-2000:], file=sys.stderr)
    print(f"{label:>4}  {'noticed' if noticed else 'survives'}  {time.monotonic() - began:5.0f} s  ", end="")
    print("\n      ".join(line[:200] for line in failed[:40]), flush=True)
    return noticed


def main(arguments: Sequence[str]) -> None:
    """List or run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants")
    parser.add_argument("what", choices=("list", "run"))
    parser.add_argument("--only", help="numbers, separated by commas")
    parser.add_argument("--together", action="store_true", help="all of them in one run")
    parser.epilog = "After -- follow arguments of pytest."
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    given, tests = parser.parse_args(arguments[:cut]), arguments[cut + 1 :]
    every = list(enumerate([*named(), *drawn()]))
    chosen = [every[int(k)] for k in given.only.split(",")] if given.only else every
    if given.what == "list":
        print("\n".join(f"{k:>3}  {mutant.text()}" for k, mutant in chosen))
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "copy"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(place)], check=True)
        groups = [chosen] if given.together else [[one] for one in chosen]
        noticed = sum(run(group, tests, place) for group in groups)
    print(f"{noticed} of {len(groups)} runs noticed")


if __name__ == "__main__":
    main(sys.argv[1:])
