"""Seal leakage procedure against the hold test of the rig."""

import re
from dataclasses import replace

import pytest
from identification.procedures.bench import BAR, LITRES, changed, named
from kit.mistakes import problem

from fmus.identification import results
from fmus.identification.pipeline import identify
from fmus.identification.procedures.seal_leakage import SEAL_LEAKAGE
from fmus.identification.recordings.reading import read_folder
from fmus.rig.experiments import hold
from fmus.rig.recordings import write

CAPACITANCE = 4e-3 / 1.6e9  # m3/Pa, of four litres of the machine's oil
LEAKS = (2e-13, 1e-12, 5e-12)  # m3/(s.Pa): 0.1, 0.6 and 3 L/min at 100 bar


def hold_test(folder, leak, square=0.0, seed=1):
    """Recordings of six weights on a cylinder, up and down, each held for five seconds."""
    write(folder, replace(hold(leak, square), name="hold"), seed)
    return read_folder(folder)


@pytest.mark.parametrize("leak", LEAKS)
def test_the_conductance_of_the_seals_comes_back(tmp_path, leak):
    """By the pipeline, as all procedures: value and capacitance of the oil, no warning, narrow intervals."""
    (result,) = identify(hold_test(tmp_path, leak)).results
    found = named(result)
    for name, truth in (("leakage past the seals", leak), ("capacitance of the enclosed oil", CAPACITANCE)):
        # 3.3 standard deviations: 1 in 1000 by chance, the seeds are fixed
        assert abs(found[name].value - truth) < 3.3 * found[name].sd
        assert found[name].sd < 0.03 * truth  # a thousand windows of micrometres
    assert results.named(result.findings) == []


def test_a_scratch_in_the_barrel_is_named(tmp_path):
    """A quadratic part of 0.1 L/min at 160 bar, which the linear law does not have."""
    square = 0.1 * LITRES / (160 * BAR) ** 2
    (result,) = identify(hold_test(tmp_path, LEAKS[1], square)).results
    assert [f.fault for f in results.named(result.findings)] == ["model"]


def test_wrong_signs_and_missing_sizes_are_refused(tmp_path):
    """A position that counts into the cylinder, and no bore: one line with the file."""
    (record,) = hold_test(tmp_path, LEAKS[1])
    turned = changed(record, {"position": 1.0 - record["position"]})
    told = problem(lambda: SEAL_LEAKAGE.identify([turned], {}))
    assert re.search(
        r"hold\.csv: leakage past the seals: expected positive, got -.*sign of the position", told
    )
    record.conditions.pop("bore")
    assert "bore" in problem(lambda: SEAL_LEAKAGE.identify([record], {}))
