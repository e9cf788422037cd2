"""Mutation test: which small changes of the code does no test notice?

    python -m benchmarks.mutants list linear             the mutants of a room: number, file, line, change
    python -m benchmarks.mutants run                     draw mutants of each room, run the tests near them
    python -m benchmarks.mutants run named               the changes that readers made by hand
    python -m benchmarks.mutants run engine --only 3,7   these two
    python -m benchmarks.mutants run linear -- tests/control/test_linear_by_hand.py       with these tests

A mutant is one arithmetic operator, comparison, sign or number in an expression of Python or C, but for the
heads of loops in C. `--count` of them are drawn from each room with `--seed`. The tests of its room run in
a copy of the last commit, in the order of `ROOMS`, until one fails. mutants.toml lists those that are
not run, each with its reason: most change nothing that can be observed. No mutation tool changes both
languages: mutmut and cosmic-ray know Python only.
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
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COUNT, SEED = 60, 37
MOST = 600.0  # s for the tests of one mutant; those that never end are noticed
EQUIVALENT = Path(__file__).with_suffix(".toml")
ORCHESTRATOR = "tests/orchestrator/"


class Room(NamedTuple):
    """Files whose mutants are drawn, and the tests of their neighbourhood, the sharpest first."""

    folder: str
    files: str
    tests: tuple[str, ...]


ROOMS = {
    "components": Room("fmus/components", "*.py", (
        *("tests/equations/test_transcription.py", "tests/variants/test_circuits_transcription.py"),
        *("tests/equations", "tests/variants"),
    )),
    "engine": Room("orchestrator/engine/native", "*.c", (
        *(ORCHESTRATOR + f"test_{n}.py" for n in ("coupling_input", "newton", "engine_parts", "masters")),
        *(ORCHESTRATOR + f"test_{n}.py" for n in ("orders", "loops", "error_estimate", "adaptive")),
        *(ORCHESTRATOR + f"test_{n}.py" for n in ("interface_jacobian", "simulation_loop", "energy")),
        *("tests/monolithic", "tests/orchestrator"),
    )),
    "procedures": Room("fmus/identification/procedures", "*.py", (
        *(f"tests/identification/procedures/test_{n}.py" for n in ("decisions", "balance", "findings")),
        "tests/identification/procedures",
    )),
    "linear": Room("orchestrator/linear", "*.py", (
        *(f"tests/control/test_linear_{n}.py" for n in ("modes", "search", "systems", "by_hand")),
        *(f"tests/control/test_linear_{n}.py" for n in ("physics", "machine", "use")),
    )),
    "monolithic": Room("orchestrator/monolithic", "*.py", (
        *(f"tests/monolithic/test_{n}.py" for n in ("plant", "integration", "reference")),
    )),
}  # fmt: skip
SWAPPED = {
    **{"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*", "@": "*"},
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="},
}
C_TOKEN = re.compile(
    r"(?<= )(?:[-+*/<>]|<=|>=|==|!=)(?= )"  # operators between blanks
    r"|(?<=[=(,?:] )-(?=[A-Za-z_(])|(?<=[(\[])-(?=[A-Za-z_(])"  # signs
    r"|(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])"
)
# comments, directives, texts, heads of loops
C_ASIDE = re.compile(r"/\*.*?\*/|//[^\n]*|^#[^\n]*|\"[^\"\n]*\"|\bfor \([^\n]*?\)", re.DOTALL | re.MULTILINE)
NO_VALUES = ("annotation", "returns", "decorator_list", "bases")  # of a statement in Python


class Mutant(NamedTuple):
    """The text from `begin` to `end` of a file becomes `after`."""

    file: str
    begin: int
    end: int
    before: str
    after: str

    def change(self) -> str:
        """The line with the change."""
        content = (ROOT / self.file).read_text(encoding="utf-8")
        start, stop = content.rfind("\n", 0, self.begin) + 1, content.find("\n", self.end)
        changed = content[start : self.begin] + f"[{self.before} -> {self.after}]" + content[self.end : stop]
        return changed.strip()

    def text(self) -> str:
        """Its place and the change."""
        content = (ROOT / self.file).read_text(encoding="utf-8")
        return f"{self.file}:{content.count(chr(10), 0, self.begin) + 1}: {self.change()}"


# file, text, the text that takes its place
_NAMED = (
    ("orchestrator/engine/native/error_propagation.c", "line[0] = 2.0 / 3.0 *", "line[0] = 1.0 *"),
    ("orchestrator/engine/native/error_propagation.c", "d[1] * h * h / 12.0", "d[1] * h * h / 6.0"),
    ("orchestrator/engine/native/error_propagation.c", "fourth / 720.0", "fourth / 360.0"),
    ("orchestrator/engine/native/algebraic_loop.c", "magnitude[i] = larger(p", "magnitude[i] = smaller(p"),
    ("orchestrator/engine/simulation_loop.py", "FIRST_FRACTION = 1e-3", "FIRST_FRACTION = 0.5"),
    ("fmus/components/circuit.py", "node.cavity * chamber.cavity_volume", "chamber.cavity_volume"),
    ("orchestrator/engine/accuracy.py", "False: 0.6,", "False: 1.2,"),
    ("orchestrator/engine/accuracy.py", "INSIDE = 0.5", "INSIDE = 1.0"),
    ("orchestrator/engine/accuracy.py", "FMU_TOLERANCE = 3e-2", "FMU_TOLERANCE = 9e-2"),
    ("fmus/identification/procedures/weighing.py", "-= 1.0 / len(self.tares)", "-= 1.0"),
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


def of_room(name: str) -> list[Mutant]:
    """All mutants of a room but the equivalent ones."""
    if name == "named":
        return named()
    room, known = ROOMS[name], tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))
    files = sorted((ROOT / room.folder).glob(room.files))
    return [m for file in files for m in mutants_of(file) if m.change() not in known.get(m.file, {})]


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
    """Operators and numbers of C, but for those of `C_ASIDE`."""
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
        found = re.search(r"\*\*|//|<=|>=|==|!=|[-+*/%@<>]", text)
        if found and "#" not in text:
            yield end(left) + found.start(), end(left) + found.end(), SWAPPED[found[0]]

    def visit(node: ast.AST) -> Iterator[tuple[int, int, str]]:
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Quantity":
            return
        if isinstance(node, ast.BinOp) and not isinstance(getattr(node.left, "value", 0), str):
            yield from between(node.left, node.right)
        elif isinstance(node, ast.Compare):
            yield from between(node.left, node.comparators[0])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield begin(node), begin(node) + 1, "+"
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield begin(node), end(node), number(content[begin(node) : end(node)].replace("_", ""))
        for name, field in ast.iter_fields(node):
            if name in NO_VALUES or (name == "keywords" and isinstance(node, ast.ClassDef)):
                continue
            for child in field if isinstance(field, list) else [field]:
                if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                    yield from visit(child)

    yield from visit(ast.parse(content))


class Outcome(NamedTuple):
    """What the tests say of a mutant: the one that failed, or nothing."""

    label: str
    mutant: Mutant
    seconds: float
    failed: str


def run(label: str, mutant: Mutant, tests: Sequence[str], place: Path, machine: Path) -> Outcome:
    """Run tests on a mutant, in a copy of the project, until one fails."""
    file = place / mutant.file
    content = file.read_text(encoding="utf-8")
    assert content[mutant.begin : mutant.end] == mutant.before, f"{mutant.file} is not as in the last commit"
    file.write_text(content[: mutant.begin] + mutant.after + content[mutant.end :], encoding="utf-8")
    # commands that the tests start import the copy, too
    environment = {**os.environ, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    if mutant.file.startswith("orchestrator"):  # the FMUs stay the same
        environment["HARVESTER_MACHINE"] = str(machine)
    began, failed = time.monotonic(), ""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=place, env=environment, capture_output=True, text=True, check=False, timeout=MOST
        )
        if done.returncode:
            found = re.search(r"^(?:FAILED|ERROR) (\S*)", done.stdout, re.M)
            failed = found[1] if found else (done.stdout + done.stderr)[-200:].replace("\n", " ")
    except subprocess.TimeoutExpired:
        failed = f"no end after {MOST:.0f} s"
    file.write_text(content, encoding="utf-8")
    return Outcome(label, mutant, time.monotonic() - began, failed)


def run_all(jobs: Sequence[tuple[str, Mutant, Sequence[str]]], copies: int) -> Iterator[Outcome]:
    """The outcomes of all mutants, in the order in which they end; each process has a copy of its own."""
    with tempfile.TemporaryDirectory() as folder:
        places: SimpleQueue[Path] = SimpleQueue()
        for k in range(copies):
            subprocess.run(["git", "clone", "--quiet", str(ROOT), f"{folder}/{k}"], check=True)
            places.put(Path(folder, str(k)))
        machine = Path(folder, "machine")
        subprocess.run([sys.executable, "-m", "orchestrator", "build", "--out", str(machine)], check=True)

        def one(label: str, mutant: Mutant, tests: Sequence[str]) -> Outcome:
            place = places.get()
            try:
                return run(label, mutant, tests, place, machine)
            finally:
                places.put(place)

        with ThreadPoolExecutor(copies) as pool:
            yield from (f.result() for f in as_completed([pool.submit(one, *job) for job in jobs]))


def chosen(room: str, only: str | None, count: int, seed: int) -> list[tuple[str, Mutant]]:
    """Mutants of a room with their labels: those of `only`, or a sample."""
    every = list(enumerate(of_room(room)))
    if only:
        every = [every[int(k)] for k in only.split(",")]
    elif room != "named" and len(every) > count:
        every = sorted(random.Random(seed).sample(every, count))
    return [(f"{room} {k}", mutant) for k, mutant in every]


def main(arguments: Sequence[str]) -> None:
    """List or run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants")
    parser.add_argument("what", choices=("list", "run"))
    parser.add_argument("rooms", nargs="*", help=f"of {', '.join(ROOMS)} and named; default: all")
    parser.add_argument("--only", help="numbers, separated by commas")
    parser.add_argument("--count", type=int, default=COUNT, help="mutants that are drawn from each room")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--copies", type=int, default=2, help="mutants that are tested at once")
    parser.epilog = "After -- follow arguments of pytest."
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    given, tests = parser.parse_args(arguments[:cut]), arguments[cut + 1 :]
    count = 10**6 if given.what == "list" else given.count
    jobs = [
        (label, mutant, tests or (ROOMS[room].tests if room in ROOMS else ("tests",)))
        for room in given.rooms or [*ROOMS]
        for label, mutant in chosen(room, given.only, count, given.seed)
    ]
    near = {test for room in ROOMS.values() for test in room.tests}
    if gone := sorted(test for test in near if not (ROOT / test).exists()):
        parser.error(f"no such tests: {', '.join(gone)}")  # pytest fails, as if they had noticed a mutant
    if given.what == "list":
        print("\n".join(f"{label:>16}  {mutant.text()}" for label, mutant, _ in jobs))
        return
    drawn, noticed = Counter[str](), Counter[str]()
    for outcome in run_all(jobs, given.copies):
        room = outcome.label.split()[0]
        drawn[room] += 1
        noticed[room] += bool(outcome.failed)
        told = outcome.failed or f"SURVIVES  {outcome.mutant.text()}"
        print(f"{outcome.label:>16} {outcome.seconds:5.0f} s  {told}", flush=True)
    for room, number in drawn.items():
        print(f"{room}: {noticed[room]} of {number} noticed, {100 * noticed[room] / number:.0f} %")


if __name__ == "__main__":
    main(sys.argv[1:])
