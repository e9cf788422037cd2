"""Runs the blocks of a tutorial in order, as a reader would, and compares what they print with what is shown.

    ```shell                    every line is a command that ends with status 0, or N after `# status N`
    ```python                   goes on from the python blocks before it
    ```python title="a.py"      is written to that file (any language)
    ```text                     what the block before it prints; `...` stands for anything

Indented blocks are shown, not run. Shown numbers hold to 1 %, or to one of the last digit after the point:
other compilers round otherwise, and no shown number should depend on more.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

TITLE = re.compile(r'title="([^"]+)"')
STATUS = re.compile(r"\s+# status (\d+)$")
PIECE = re.compile(
    r"(?P<any>\s*\.\.\.\s*)|(?P<number>(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.]*\.\w))|(?P<space>\s+)"
)
OWN = 0.01  # share by which a number may differ


@dataclass
class Tutorial:
    """A document that is run in a folder."""

    path: Path
    folder: Path
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "tutorial"})
    printed: str = ""

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
            raise AssertionError(
                f"a block of {language or 'no language'}: expected shell, python, text or a title"
            )

    def command(self, line: str) -> str:
        """What a command prints."""
        asked = STATUS.search(line)
        paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        environment = {
            **os.environ,
            "PATH": paths,
            "COLUMNS": "110",
            "MPLBACKEND": "agg",
            "PYTHONWARNINGS": "error",
        }
        done = subprocess.run(
            line[: asked.start()] if asked else line,
            shell=True, cwd=self.folder, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        expected = int(asked[1]) if asked else 0
        assert done.returncode == expected, f"{line}: status {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    def python(self, text: str) -> str:
        """What a snippet prints."""
        with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.chdir(self.folder):
            exec(compile(text, self.path.name, "exec"), self.names)
        return printed.getvalue()


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
    far = [
        f"{a} is shown, {b} printed" for a, b in zip(numbers, same.groups(), strict=True) if not near(a, b)
    ]
    return "; ".join(far)


PATTERNS: Mapping[str, str] = {"any": ".*?", "number": r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)", "space": r"\s+"}


def near(shown: str, printed: str) -> bool:
    """Are two numbers equal to 1 %, or to one of the last digit shown after the point?"""
    digits, _, exponent = shown.partition("e")
    places = len(digits.partition(".")[2])
    last = 10.0 ** (int(exponent or 0) - places) if places else 0.0
    return abs(float(shown) - float(printed)) <= max(OWN * abs(float(shown)), 1.001 * last)
