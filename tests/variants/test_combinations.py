"""The registry and what it prints; every combination of variants in the machine, also at rest in a pose."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from kit import shards
from kit.equations import in_pose, machine, piston_areas, played
from kit.every import MACHINES
from kit.scripts import names_of

from fmus.machine.parts import FAMILIES, FERIC
from fmus.machine.tables import variant_names
from fmus.parameters import values
from orchestrator.__main__ import main
from orchestrator.base import files

DOCS = Path(__file__).parents[2] / "docs"
combinations = names_of(DOCS / "fidelity_combinations.py")["combinations"]
VARIANTS = {part: list(family) for part, family in FAMILIES.items()}
ALL_COMBINATIONS = [dict(zip(VARIANTS, v, strict=True)) for v in itertools.product(*VARIANTS.values())]
SOME = ALL_COMBINATIONS[::26]
WATCH = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]


def test_variants_are_listed_with_size_validity_and_measured_cost(fmu_dir, capsys, monkeypatch):
    """Every variant with its states and inputs, where it holds, and its cost beside the usual one's."""
    monkeypatch.setattr("orchestrator.studies.variant_costs.LENGTH", 0.02)
    monkeypatch.setattr("orchestrator.studies.variant_costs.REPEATS", 1)
    assert main(["variants", "--cost", str(fmu_dir / "harvester.ssp")]) == 0
    printed = capsys.readouterr().out
    indented = (line for line in printed.splitlines() if line.startswith("  ") and line[2] != " ")
    rows = {line.split()[0]: line.split() for line in indented}
    assert {variant for _, variant in variant_names()} <= set(rows)
    assert rows["detailed"][1:3] == ["32", "19"]  # of boom_stick, the last one
    assert printed.count("valid: ") == len(variant_names())
    costs = {name: float(row[-1]) for name, row in rows.items()}
    assert costs["rigid"] == 1.0  # a ratio to the usual variant
    assert all(cost > 0 for cost in costs.values())


def test_variants_are_listed_before_anything_is_built(tmp_path, monkeypatch, capsys):
    """Without a measurement, and the way to get one is told; that one needs the system."""
    monkeypatch.chdir(tmp_path)
    assert main(["variants"]) == 0
    printed = capsys.readouterr().out
    assert "quasistatic" in printed
    assert printed.endswith("on this computer: harvester variants --cost\n")
    assert main(["variants", "foo"]) == 2
    assert capsys.readouterr() == ("", "harvester: variants foo: a system is only read with --cost\n")
    monkeypatch.setattr(files, "CHECKOUT", tmp_path)
    assert main(["variants", "--cost"]) == 2
    assert "harvester.ssp: no such file; build it with: harvester build" in capsys.readouterr().err


@pytest.mark.parametrize("chosen", SOME, ids=lambda c: "-".join(c.values()))
def test_a_combination_starts_and_moves(system, chosen):
    """Every 26th combination, every variant among them, over two seconds: boom and swing have started."""
    one = {part: [variant] for part, variant in chosen.items()}
    (row,) = combinations(system, one, WATCH, step=1e-3, stop=2.0, record_step=0.02)
    assert row.failure == ""
    assert row.reached == pytest.approx(2.0)


def test_the_sample_has_every_variant():
    """The sample above leaves no variant out."""
    assert {item for chosen in SOME for item in chosen.items()} == set(variant_names())
    assert len(ALL_COMBINATIONS) == 4 * 4 * 4 * 3


@shards.machine
def test_every_combination_runs_the_work_cycle(system):
    """42 s at 1 ms with the default master, and the coupling makes up no energy to speak of."""
    found = list(combinations(system, VARIANTS, WATCH, step=1e-3, record_step=0.02))
    assert [dict(row.variants) for row in found] == ALL_COMBINATIONS
    for row in found:
        assert row.failure == "", row.variants
        assert row.reached == pytest.approx(42.0), row.variants
        drives = (row.variants["swing"], row.variants["boom_stick"])
        # without its rate port a bond makes up percents; with load sensing the bond of pump and swing is of
        # order one, 1.45e-4 at 1 ms, four times the suggested step; elsewhere a tenth of 1e-4 at most
        if row.residual >= (2e-4 if row.variants["supply"] == "load_sensing" else 1e-4):
            # an open anti-cavitation valve and the return line have a time constant of 0.7 ms: up to 4.5e-3
            # if several are open, and at most 1.4e-5 at half the step
            assert {"detailed", "compensated"} & {*drives}, row.variants
            assert row.variants["supply"] != "ideal", row.variants
            one = {part: [variant] for part, variant in row.variants.items()}
            (half,) = combinations(system, one, WATCH, step=5e-4, record_step=0.02)
            assert half.residual < 1e-4, row.variants
        # load_sensing: a fifth of the pressure drop at the valves, slower; compensated: another circuit
        if row.variants["supply"] != "load_sensing" and "compensated" not in drives:
            assert row.change < 0.1, row.variants  # another fidelity, not another machine


# ---- every variant in its machine: started at a pose with the levers at rest, it stands

STAND = 1.0  # s
POSES = ("nominal", "reach", "folded")
# each machine in one pose, each pose twice
CASES = [
    pytest.param(i, pose, marks=() if i % 3 == k else shards.machine)
    for i in range(len(MACHINES))
    for k, pose in enumerate(POSES)
]


def test_machines_hold_every_variant():
    """The machines of the suite leave no variant out."""
    met = {(part, m.get(part, next(iter(variants)))) for m in MACHINES for part, variants in FAMILIES.items()}
    assert met == {(part, v) for part, variants in FAMILIES.items() for v in variants}


@pytest.mark.parametrize(("index", "pose"), CASES)
def test_a_machine_of_any_variants_stands_still(index, pose):
    """No piston moves farther than the leakage of its edges allows; the swing, which has no load, not at all.

    Each chamber gains or loses at most G_leak P t through its edges, with P the highest pressure around.
    """
    model = machine(**MACHINES[index])
    shown = played(model, np.linspace(0.0, STAND, 21), {}, in_pose(model, pose), tolerance=1e-10)
    numbers = values(FERIC.chosen(**MACHINES[index])["boom_stick"]).p
    given = dict(zip(model.inputs, model.u, strict=True)).get("supply_pressure", 0.0)
    highest = max(given, *(np.max(v) for n, v in shown.items() if n.endswith("_pressure")))
    for joint in ("boom", "stick"):
        bound = STAND * numbers["valve_leakage"] * highest / piston_areas(numbers, joint)[1]
        assert bound < 0.1e-3  # m: small itself, so that this says something
        assert np.ptp(shown[f"manipulator.{joint}_position"]) < bound
    assert np.ptp(shown["manipulator.swing_angle"]) < 1e-9  # rad: rounding of gravity terms
