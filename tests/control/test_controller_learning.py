"""The controller learns its valves: to the truth, again after a jump, and nothing at rest."""

import json
import re

import numpy as np
import pytest

from benchmarks.learning import AXES, Case, dead_band, tracked
from orchestrator import Trace, run
from orchestrator.__main__ import main

LEARNED = [f"{a}_{n}_{of}" for a in AXES for n in ("dead_band", "flow") for of in ("up", "down")]
KEPT = [f"controller.{n}" for n in (*LEARNED, *(f"{a}_half_width" for a in AXES))]
BANDS = [n for n in KEPT if "dead_band" in n]


def worked(machine, monkeypatch, given, **of) -> tuple[np.ndarray, Trace, float]:
    monkeypatch.setattr("benchmarks.learning.IDEAL", machine)
    return tracked(Case("lumped", "line", False, given, **of), KEPT)


@pytest.mark.parametrize("by", [-0.2, 0.2])
def test_dead_bands_come_out_as_they_are(machine, monkeypatch, by):
    """Each direction of each valve, from 45 s of other work: within 0.03 V, a seventh of what was wrong."""
    error, trace, begin = worked(machine, monkeypatch, dead_band("lumped", by))
    for name in BANDS:
        # lags of spool and oil that the observer leaves out are errors of the valve of this size
        assert trace[name][-1] == pytest.approx(by, abs=0.03), name
    on = trace.time >= begin
    assert error[on].max() < 0.010  # 14 and 28 mm without learning
    assert np.sqrt((error[on] ** 2).mean()) < 0.004


def test_the_command_keeps_what_was_learned_in_a_file(machine, tmp_path, capsys):
    """Dead bands and play that nobody knows: a run with the file begins as good as the last one ended."""
    system, file = str(machine), tmp_path / "learned.ssv"
    other = dead_band("lumped", 0.2) | {"valve_actuation.hysteresis": 0.06}  # assumed: 4 %
    given = [f"--set={n}={x}" for n, x in other.items()] + ["--swap=swing=lumped", "--no-compare"]
    given += [f"--out={tmp_path}", "--set=controller.learning=1"]

    def ridden(*more: str) -> list[float]:
        assert main(["track", system, *given, *more]) == 0
        return [r["largest error [m]"] for r in json.loads((tmp_path / "tracking.json").read_text())["runs"]]

    first, last = ridden(f"--learned={file}")
    assert f"{file}: 13 values that the controller has learned" in capsys.readouterr().out
    assert first > 0.025  # 30 mm without the file
    again = ridden(f"--parameters={file}")
    assert max(again) < 1.2 * last  # a third of the first; two paths differ by this
    values = dict(re.findall(r'name="controller\.(\w+)">\s*<ssv:Real value="(\S+)"', file.read_text()))
    assert float(values["hysteresis"]) == pytest.approx(0.06, abs=0.005)  # 0.05 V of play, of 10 V
    for name in BANDS:
        assert float(values[name.partition(".")[2]]) == pytest.approx(0.2, abs=0.05), name  # 40 s in all


def test_ten_minutes_at_rest_teach_nothing(machine):
    """Engaged without a wish, dead bands off by 0.2 V either way: learned values are those of the start."""
    for by in (-0.2, 0.2):
        still = Trace(np.array([0.0, 600.0]), {"controller.engaged": np.ones(2)})
        start = dead_band("lumped", by) | {"controller.boom_dead_band_up": 0.1, "controller.learning": 1.0}
        trace = run(machine, still, record=KEPT, record_step=1.0, step=10e-3, set=start).trace
        for name in KEPT:
            assert np.ptp(trace[name]) < 1e-12, name


def test_a_jump_of_the_dead_band_is_learned_within_half_a_minute(machine, monkeypatch):
    """Learned 0.2 V that are no longer there: a quarter is left after 30 s, a few for each direction."""
    start = dict.fromkeys(BANDS, 0.2)
    _, trace, begin = worked(machine, monkeypatch, start, before=30.0)
    at_begin = np.searchsorted(trace.time, begin)
    np.testing.assert_allclose([trace[n][at_begin] for n in BANDS], 0.0, atol=0.05)
