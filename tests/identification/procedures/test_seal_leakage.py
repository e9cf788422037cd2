"""Seal leakage procedure against the solver, the circuits and the instruments of the rig."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from identification.procedures.bench import BAR, LITRES, changed, named
from kit.mistakes import problem

from fmus.components.circuit import GROUND, TANK, Branch, Circuit, Kind, Node
from fmus.identification import results
from fmus.identification.pipeline import identify
from fmus.identification.procedures.leakage import SEAL_LEAKAGE
from fmus.identification.recordings.reading import read_folder
from fmus.rig import benches
from fmus.rig.experiments import levels
from fmus.rig.instruments import PRESSURE, Experiment
from fmus.rig.recordings import write
from orchestrator.data.description import Condition, SignalDescription

BORE, VOLUME, MODULUS = 0.1, 4e-3, 1.6e9  # m, m3, Pa
AREA, CAPACITANCE = math.pi / 4 * BORE**2, VOLUME / MODULUS
SINKING = 0.05  # s, time constant of the piston behind its friction
# a string potentiometer over 1 m with 16 bit
POSITION = SignalDescription("m", sensor="string", noise=2e-6, resolution=1 / 2**16, span=(0.0, 1.0))
LEAKS = (2e-13, 1e-12, 5e-12)  # m3/(s.Pa): 0.1, 0.6 and 3 L/min at 100 bar


def hold_test(folder, leak, square=0.0, seed=1):
    """Recordings of four weights on a cylinder, up and down, each held for five seconds; both directions."""
    weights = np.array([40.0, 80.0, 120.0, 160.0, 100.0, 60.0]) * BAR * AREA  # N
    time, load = levels(weights, 5.0, 0.2)
    damping = SINKING * AREA**2 / CAPACITANCE

    def bench(x, u):
        velocity = (AREA * x["head"] - u["load"]) / damping

        def past(drop):
            return leak * drop + square * drop * ca.fabs(drop)

        circuit = Circuit(
            {"head": Node(x["head"], "C", CAPACITANCE), TANK: Node(benches.RETURN), GROUND: Node(0)},
            {
                "seal": Branch("head", TANK, Kind.LEAKAGE, past),
                "piston": Branch("head", GROUND, Kind.PISTON, AREA * velocity),
            },
        )
        outputs = {
            "position": x["position"],
            "pressure_head": x["head"],
            "pressure_rod": ca.SX(benches.RETURN),
        }
        return circuit, {"position": velocity}, outputs

    start = {"head": (weights[0] / AREA, 1e7), "position": (0.9, 1.0)}
    signals = benches.run(start, bench, time, {"load": load})
    instruments = {n: POSITION if n == "position" else PRESSURE for n in signals}
    done = Experiment(
        *("seal_leakage", "Hold test", time, signals, instruments),
        conditions={"bore": Condition(BORE, "m")},
        name="hold",
        machine="lumped",
    )
    write(folder, done, seed)
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
