"""Runs the blocks of a tutorial in order, as a reader would, and compares what they print with what is shown.

    ```shell                    every line is a command that ends with status 0, or N after `# status N`
    ```python                   goes on from the python blocks before it
    ```python title="a.py"      is written to that file (any language)
    ```text                     what the block before it prints; `...` stands for anything in its line, and
                                a line of `...` alone for any lines

In a tutorial indented blocks are shown, not run; in a `Page` those of commands are run. What cannot run has a
mark in front: `<!-- not run: REASON -->`, or of some lines only `<!-- not run: `harvester view`, REASON -->`.

Whole numbers are counts and hold exactly. Other shown numbers hold to 1 %, or to one of the last digit after
the point: other compilers round otherwise, and no shown number should depend on more.
"""

import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from markdown_it import MarkdownIt

TITLE = re.compile(r'title="([^"]+)"')
STATUS = re.compile(r"\s+#.*\bstatus (\d+)\b.*$")
PIECE = re.compile(
    r"(?P<lines>(?:\A|\s*\n)[ \t]*\.\.\.[ \t]*(?:\n\s*|\Z))"
    r"|(?P<any>[ \t]*\.\.\.[ \t]*)"
    r"|(?P<number>(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.]*\.\w))"
    r"|(?P<space>\s+)"
)
OWN = 0.01  # share by which a number may differ


@dataclass
class Tutorial:
    """A document that is run in a folder."""

    path: Path
    folder: Path
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "tutorial"})
    printed: str = ""
    programs: Path = Path(sys.executable).parent  # of `harvester` and `python`

    def run(self) -> None:
        """All blocks, in order."""
        for line, info, text in blocks(self.path):
            try:
                self.block(info, text)
            except AssertionError as fault:
                raise AssertionError(f"{self.path.name}:{line}: {fault}") from None

    def block(self, info: str, text: str) -> None:
        """One block."""
        title, language = TITLE.search(info), info.split(maxsplit=1)[0] if info else ""
        if title:
            (self.folder / title[1]).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / title[1]).write_text(text, encoding="utf-8")
        elif language == "shell":
            self.printed = "".join(self.command(line) for line in text.splitlines())
        elif language == "python":
            self.printed = self.python(text)
        elif language == "text":
            fault = difference(text, self.printed)
            assert not fault, fault
        else:
            found = language or "no language"
            raise AssertionError(f"a block of {found}: expected shell, python, text or a title")

    def command(self, line: str) -> str:
        """What a command prints."""
        asked = STATUS.search(line)
        done = subprocess.run(
            line[: asked.start()] if asked else line,
            shell=True, cwd=self.folder, env=self.environment(), capture_output=True, text=True, check=False,
        )  # fmt: skip
        expected = int(asked[1]) if asked else 0
        assert done.returncode == expected, f"{line}: status {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    def environment(self) -> dict[str, str]:
        """Commands are those of the interpreter that runs the tests; a warning of Python is an error."""
        paths = os.pathsep.join([str(self.programs), os.environ["PATH"]])
        fixed = {"PATH": paths, "COLUMNS": "110", "MPLBACKEND": "agg", "PYTHONWARNINGS": "error"}
        return {**os.environ, **fixed}

    def python(self, text: str) -> str:
        """What a snippet prints; another interpreter has only the names of this snippet."""
        if self.programs != Tutorial.programs:
            return self.command(f"python -c {shlex.quote(text)}")
        with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.chdir(self.folder):
            exec(compile(text, self.path.name, "exec"), self.names)
        return printed.getvalue()


COMMANDS = ("harvester", "make", "python", "pip", "py", "omc", ".venv")
LASTING = ("harvester view",)
MARK = re.compile(r"<!-- not run: (?:`([^`]+)`, )?(.+?) -->", re.DOTALL)


@dataclass
class Page(Tutorial):
    """A page of documentation: what it prints as commands, indented or not, and as Python."""

    def units(self) -> Iterator[tuple[int, str, str, str]]:
        """Line, kind (python, command, text or file), text, and the reason why it is not run, or nothing."""
        marks, last = list[tuple[str, str]](), False
        for token in MarkdownIt().parse(self.path.read_text(encoding="utf-8")):
            if token.type == "html_block":
                marks += MARK.findall(token.content)
                continue
            if token.type not in ("fence", "code_block"):
                marks, last = [], False
                continue
            assert token.map
            line, info, text = token.map[0] + 1, token.info.strip(), token.content
            if TITLE.search(info):
                yield line, info, text, ""
            elif info.startswith("python"):
                yield line, "python", text, marks[0][1] if marks else ""
            elif info == "shell" or (not info and text.startswith(COMMANDS)):
                assert all(any(one.startswith(o) for one in text.splitlines()) for o, _ in marks), marks
                for one in filter(None, text.replace("\\\n", " ").splitlines()):
                    reason = next((why for only, why in marks if one.startswith(only)), "")
                    yield line, "command", one, reason
            elif info == "text" and last:
                yield line, "text", text, marks[0][1] if marks else ""
            marks, last = [], info in ("python", "shell") or text.startswith(COMMANDS)

    def run(self) -> None:
        """All units that are not marked, in order."""
        begun = 0
        for line, kind, text, reason in self.units():
            if reason:
                continue
            try:
                if kind == "command":
                    before, begun = self.printed if line == begun else "", line
                    self.printed = before + (self.serve if text.startswith(LASTING) else self.command)(text)
                else:
                    self.block(kind, text)
            except Exception as fault:
                raise AssertionError(f"{self.path.name}:{line}: {fault}\n{text}") from fault

    def serve(self, line: str) -> str:
        """What a server printed until it answered; then it is interrupted, which is no failure."""
        with subprocess.Popen(
            f"exec {line}", shell=True, cwd=self.folder, env=self.environment(), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        ) as server:  # fmt: skip
            assert server.stdout
            told = ""
            try:
                while not (address := re.search(r"http://[^\s,]+", told)):
                    printed = server.stdout.readline()
                    assert printed, f"{line}: ended\n{told}"
                    told += printed
                with urlopen(address[0], timeout=60) as answer:
                    assert answer.status == 200
            finally:
                os.killpg(server.pid, signal.SIGINT)
            rest, _ = server.communicate(timeout=120)
        assert server.returncode in (0, 130), f"{line}: status {server.returncode}\n{told}{rest}"
        return told


def blocks(path: Path) -> Iterator[tuple[int, str, str]]:
    """Line, language with its title, and text of each fenced block."""
    for token in MarkdownIt().parse(path.read_text(encoding="utf-8")):
        if token.type == "fence" and token.map:
            yield token.map[0] + 1, token.info.strip(), token.content


def difference(shown: str, printed: str) -> str:
    """What differs between the output that is shown and the one that was printed, if something does."""
    numbers: list[str] = []

    def piece(found: re.Match[str]) -> str:
        if found["number"]:
            numbers.append(found["number"])
        return next(pattern for name, pattern in PATTERNS.items() if found[name])

    plain, end = "", 0
    for found in PIECE.finditer(shown.strip()):
        plain += re.escape(shown.strip()[end : found.start()]) + piece(found)
        end = found.end()
    plain += re.escape(shown.strip()[end:])
    same = re.fullmatch(plain, printed.strip(), re.DOTALL)
    if same is None:
        return f"shown\n{shown}\nprinted\n{printed}"
    far = ((a, b) for a, b in zip(numbers, same.groups(), strict=True) if not near(a, b))
    return "; ".join(f"{a} is shown, {b} printed" for a, b in far)


PATTERNS: Mapping[str, str] = {
    "lines": ".*?",
    "any": r"[^\n]*?",
    "number": r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)",
    "space": r"\s+",
}


def near(shown: str, printed: str) -> bool:
    """Are whole numbers equal, others to 1 % or to one of the last digit shown after the point?"""
    digits, _, exponent = shown.partition("e")
    places = len(digits.partition(".")[2])
    if not places and not exponent:
        return float(shown) == float(printed)
    last = 10.0 ** (int(exponent or 0) - places) if places else 0.0
    return abs(float(shown) - float(printed)) <= max(OWN * abs(float(shown)), 1.001 * last)
