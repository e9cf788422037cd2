"""FMUs that do what no FMU may, through every command; the table in docs/run.md says how each ends."""

import random
from pathlib import Path

import pytest
from kit import shards
from kit.needs import needs

from benchmarks.hostile import COMMANDS, MOST_DELAY, SEED, play
from zoo.faulty import MISUSES

pytestmark = needs("Linux", "misuses and signals of Linux")
PAGE = Path(__file__).parents[2] / "docs/run.md"
CASES = [(misuse, name) for misuse in MISUSES for name in COMMANDS]
# `check` allows a call a time, in which a fast computer takes 2 GB, and a slow disk does not make the folders
BY_SPEED = [("take", "check", "complete"), ("nest", "check", "limit")]
# a process that is replaced, one that is copied, a connection that is written to
QUICK = [("exec", "run"), ("twin", "run"), ("garbage", "accuracy")]


def documented(misuse: str, name: str) -> str:
    """The word in the table."""
    lines, begin = PAGE.read_text("utf-8").splitlines(), f"| {MISUSES[misuse]} |"
    row = next(line for line in lines if line.startswith(begin))
    return row.split("|")[2 + COMMANDS.index(name)].strip()


@pytest.mark.parametrize(("misuse", "name"), shards.few(QUICK, CASES, shards.faults))
def test_a_misuse_ends_as_documented(tmp_path: Path, misuse: str, name: str) -> None:
    """In at most one line that names the FMU, with each row until then once, and nothing is left."""
    word = play(misuse, name, tmp_path).word
    assert word == documented(misuse, name) or (misuse, name, word) in BY_SPEED


QUICKER = [("exec", "batch"), ("signals", "run")]


@pytest.mark.parametrize(("misuse", "name"), shards.few(QUICKER, CASES, shards.faults))
def test_an_interrupt_at_any_time_leaves_nothing(tmp_path: Path, misuse: str, name: str) -> None:
    """And the same holds."""
    play(misuse, name, tmp_path, random.Random(f"{SEED} {misuse} {name}").uniform(0.0, MOST_DELAY))
