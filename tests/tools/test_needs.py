"""Why a test may be skipped: only for what a computer lacks, and not for what is installed."""

import re
from pathlib import Path

import pytest
from kit.needs import PACKAGES, hidden

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("reason", "wrong"),
    [
        ("needs OpenModelica: omc is not on the search path", False),
        ("needs valgrind", False),
        ("needs gcc", True),  # a package that is installed, and yet the test did not find it
        ("needs libtbb12: ecospy cannot be loaded", False),
        ("needs gymnasium", True),  # the extra `test` brings it
        ("could not import 'pinocchio'", True),
        ("gcc", True),
        ("Linux only", True),
    ],
)
def test_a_skip_that_hides_a_missing_step_is_told(reason, wrong):
    """With gcc as the only installed package."""
    assert bool(hidden([reason], lambda name: name == "gcc")) == wrong


def test_ci_installs_what_tests_need():
    """Each Debian package that a test may lack is one that .ci/run installs."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    installed = {
        word for words in re.findall(r"^(?:NEEDED|WANTED)=\((.*)\)", script, re.M) for word in words.split()
    }
    assert installed >= {*PACKAGES}


def test_no_test_is_skipped_in_another_way():
    """By a mark or a call of pytest itself: its reason would be none of those that are declared."""
    other = re.compile(r"skipif|pytest\.skip\(|importorskip|mark\.skip")
    own = {Path(__file__), ROOT / "tests" / "kit" / "needs.py"}
    used = {
        path.name: other.findall(path.read_text(encoding="utf-8"))
        for path in (ROOT / "tests").rglob("*.py")
        if path not in own
    }
    assert {name: found for name, found in used.items() if found} == {}
