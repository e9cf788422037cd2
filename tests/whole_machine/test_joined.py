"""The machine as one composed subsystem: names, equations, and its FMU against the monolithic solution."""

# ruff: noqa: ARG005  (observe and require take x, u, p, whatever a toy uses)

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import mistakes
from kit.toy import toy

from fmus.composition import compose, declared, flat_names
from fmus.contract import Quantity, Subsystem, quantities, symbolic
from fmus.machine.build import data
from fmus.machine.one_block import HARVESTER, HIDDEN, TEXTS, TOTALS
from fmus.machine.parts import FERIC
from fmus.monolith import join
from fmus.parameters import Number, numbers, values
from orchestrator import run
from orchestrator.data.recording import read_recording
from orchestrator.results.layout import Layout
from orchestrator.results.validate_system import comparable
from orchestrator.results.validation import validate

TABLES = {name: numbers(sub) for name, sub in FERIC.subsystems.items()}
NAMES = flat_names(FERIC.subsystems, TABLES, FERIC.inputs, TOTALS, HIDDEN)
NUMBERS = values(HARVESTER)
WAY, AIM = Quantity("m", "Way"), Quantity("m", "Aim")  # of the toys


def test_every_variable_of_the_components_has_a_name():
    """All states, parameters and outputs are in the composed subsystem, declared alike, and no others."""
    for group in ("states", "parameters", "outputs"):
        known = quantities(getattr(HARVESTER, group))
        wanted = {v: q for v, q in declared(FERIC.subsystems, group).items() if v not in HIDDEN}
        assert {NAMES[v] for v in wanted} == set(known)
        for v, quantity in wanted.items():
            if NAMES[v] not in TEXTS:
                assert known[NAMES[v]] == quantity


def test_names_are_those_a_user_expects():
    """Local names if unique; oil and geometry once; prefixed with the component if two differ."""
    parameters = quantities(HARVESTER.parameters)
    assert {"density", "valve_area", "boom_stroke", "stick_stroke", "head_mass"} <= set(parameters)
    prefixed = [n for n in parameters if n.startswith(("swing_", "boom_stick_", "manipulator_"))]
    own = [n for n in prefixed if not n.startswith("swing_stop_")]  # that is the manipulator's name of it
    assert own == ["swing_initial_preload", "boom_stick_initial_preload", "swing_damping"]
    inputs = quantities(HARVESTER.inputs)
    assert list(inputs) == list(FERIC.inputs)
    assert inputs["boom_command"].rate == "boom_command_rate"
    outputs = quantities(HARVESTER.outputs)
    assert {"boom_force", "boom_velocity", "boom_acceleration", "supply_flow", "tip_x"} <= set(outputs)
    assert not [n for n in outputs if n.endswith(("_rate", "_holding_force"))]


def test_numbers_are_those_of_the_components():
    """Value, unit, source and note of each parameter and start value are those of a component."""
    found = numbers(HARVESTER)
    sources = {
        (section, NAMES.get(f"{c}.{n}", n)): number
        for c, table in reversed(TABLES.items())
        for section, entries in table.items()
        for n, number in entries.items()
    }
    for section, entries in found.items():
        for name, number in entries.items():
            assert number == sources[section, name]
    assert set(NUMBERS.p) == set(found["parameters"])
    pose = "initial_boom_angle"
    assert NUMBERS.p[pose] == TABLES["manipulator"]["parameters"][pose].value
    assert NUMBERS.u["supply_pressure"] == TABLES["swing"]["start"]["supply_pressure"].value


def part(name: str, gain: float = 2.0, text: str = "Gain", **quantity: Any) -> tuple[Subsystem, Any]:
    """A lag y' = gain (u - y), and its tables."""
    lag = toy(
        name,
        p={"gain": Quantity("1/s", text, **quantity)},
        x={"y": WAY},
        u={"u": AIM},
        y={"y": WAY, "aim": AIM},
        f=lambda s, i, k: {"y": k.gain * (i.u - s.y)},
        g=lambda s, i, k: {"y": s.y, "aim": i.u},
        require=lambda s, i, k: {"gain is positive": k.gain},
    )
    note = Number(gain, "1/s", "assumed", "")
    return lag, {"parameters": {"gain": note}, "start": {"u": Number(0.5, "m", "assumed", "")}}


def chain(first: tuple[Subsystem, Any], second: tuple[Subsystem, Any], **more: Any) -> Subsystem:
    """Two lags in series."""
    parts = {sub.name: sub for sub, _ in (first, second)}
    tables = {sub.name: table for sub, table in (first, second)}
    wires = more.pop("wires", [("a.y", "b.u")])
    inputs = more.pop("inputs", {"aim_of_all": ("a.u",)})
    return compose("chain", "Chain", parts, wires, inputs, tables, folder=Path("none"), **more)


@mistakes.table(__file__, "shared", "changes, expected")
def test_parameters_are_one_if_declared_alike_and_equal(changes, expected):
    """Same description, unit, bounds and value; otherwise each component has its own parameter."""
    whole = chain(part("a"), part("b", **changes))
    assert list(quantities(whole.parameters)) == expected
    assert list(values(whole).p) == expected
    # one requirement for one parameter, two for two
    assert len(symbolic(whole).statements) == len(expected)


def test_what_has_one_name_gets_its_component_or_is_summed():
    """Requirements, states and outputs of two gains; a total is one output with the local name."""
    whole = chain(part("a"), part("b", gain=3.0))
    assert symbolic(whole).statements == ("gain is positive", "b: gain is positive")
    assert list(quantities(whole.states)) == ["a_y", "b_y"]
    assert list(quantities(whole.outputs)) == ["a_y", "a_aim", "b_y", "b_aim"]
    whole = chain(part("a"), part("b"), totals=("aim",), hidden=("a.y", "b.y"), texts={"aim": "All aims"})
    assert {n: q.text for n, q in quantities(whole.outputs).items()} == {"aim": "All aims"}
    y = symbolic(whole).function()([1.0, 2.0], [5.0], [2.0])[1]
    assert float(y) == 5.0 + 1.0  # the aim of all and the way of a


@mistakes.table(__file__, "connections", "changes, message")
def test_wrong_connections_are_refused(changes, message):
    """The message names the variable."""
    mistakes.problem(lambda: chain(part("a"), part("b"), **changes), message)


def test_targets_of_an_input_start_alike():
    """Targets of one input have equal start values."""
    second = part("b")
    second[1]["start"]["u"] = Number(0.25, "m", "assumed", "")
    told = r"all feeds a\.u and b\.u, which have different units or start values"
    mistakes.problem(lambda: chain(part("a"), second, wires=[], inputs={"all": ("a.u", "b.u")}), told)


def test_equations_are_those_of_the_monolith():
    """Derivatives, outputs and initial states at random points and for random parameters."""
    model, whole = join(FERIC.subsystems, FERIC.connections, FERIC.inputs), symbolic(HARVESTER)
    start = whole.initial()
    first = start(*(list(group.values()) for group in (NUMBERS.x, NUMBERS.u, NUMBERS.p))).full()[:, 0]
    rng = np.random.default_rng(3)
    nominal = np.array([q.nominal for q in quantities(HARVESTER.states).values()])
    for _ in range(10):
        x = first + 0.1 * nominal * rng.normal(size=nominal.size)
        u = model.u + rng.uniform(-5, 5, model.u.size)
        p = {n: v * rng.uniform(0.99, 1.01) for n, v in NUMBERS.p.items()}
        all_p = [p[NAMES[v]] for v in model.parameters]
        dx, y = whole.function()(x, u, list(p.values()))
        expected = dict(zip(model.output_names, model.outputs(x, u, all_p).full()[:, 0], strict=True))
        named = quantities(HARVESTER.outputs)
        shown = [sum(expected[v] for v in expected if NAMES.get(v) == n) for n in named]
        # the same expressions in another order: rounding
        np.testing.assert_allclose(dx.full(), model.right_hand_side(x, u, all_p).full(), rtol=1e-9)
        np.testing.assert_allclose(y.full()[:, 0], shown, rtol=1e-9)
        np.testing.assert_allclose(start(x, u, list(p.values())), model.start(x, u, all_p), rtol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_fmu_meets_the_reference_within_ten_times_its_tolerance(fmu_dir, tolerance):
    """The whole work cycle at 1 ms: error of every signal of the reference over its range."""
    reference = read_recording(data("reference/work_cycle.csv"))
    options = {"step": 1e-3, "record_step": 0.02, "tolerance": tolerance}
    found = run(fmu_dir / "harvester.fmu", data("scenarios/work_cycle.csv"), **options)
    reference, trace = comparable(found.system, found.trace, reference, Layout())
    outcome = validate(trace, reference)
    # the bar of the issue; the reference has nine digits, so that 1e-7 of range is still seen
    assert max(row.metrics.nrmse for row in outcome.rows) <= 10 * tolerance
    assert not found.messages
