"""The project's monolith and a second, independent writing of docs/equations.md are the same machine."""

import itertools

import numpy as np
import pytest
from equations import transcription
from kit.equations import EDGES, JOINTS, random_curve

from fmus.machine.parts import FERIC
from fmus.machine.poses import pose_grid
from fmus.monolith import join

# parameters that are zero by choice get a size here, so that a wrong term with them shows
SIZE_OF_ZEROS = {"swing.line_turbulent_resistance": 1e10, "manipulator.swing_stop_angle": 2.0}
# zeros that stand for what length and bore lead to, and measured numbers in their place
HOSES = {
    **{f"boom_stick.{hose}_inertance": 1.2e7 for hose in ("boom_hose", "stick_hose")},
    **{f"boom_stick.{hose}_capacitance": 6e-13 for hose in ("boom_hose", "stick_hose")},
    **{f"boom_stick.{hose}_resistance": 3e10 for hose in ("boom_hose", "stick_hose")},
    **{"swing.line_inertance": 3e6, "swing.line_capacitance": 1e-12, "swing.line_resistance": 6e6},
}
PRESSURES = ("supply_pressure", "tank_pressure")
INPUTS = (*(f"{joint}_command" for joint in JOINTS), *PRESSURES, "payload_mass", "oil_temperature")


@pytest.fixture(scope="module")
def model():
    """The project's joined ODE; other inputs do not enter it."""
    inputs = {name: FERIC.inputs[name] for name in INPUTS}
    return join(FERIC.subsystems, FERIC.connections, inputs)


def random_numbers(rng):
    """All parameters, each moved by up to 20 %; zeros get a size, those of hoses in every second case."""
    sizes = SIZE_OF_ZEROS | (HOSES if rng.random() < 0.5 else dict.fromkeys(HOSES, 0.0))
    for part, edge in itertools.product(("swing", "boom_stick"), EDGES):
        sizes |= random_curve(rng, f"{part}.valve_{edge}")
    return {
        name: value * rng.uniform(0.8, 1.2) if value else sizes.get(name, 0.1)
        for name, value in transcription.numbers().items()
    }


def random_point(rng):
    """States (20,) and inputs (7,) in and around the working range.

    Also cold oil, voids, end stops, full commands, mass that is picked up and mass that is dropped.
    """
    oil = [[*rng.uniform(-1e5, 21e6, 2), *rng.uniform(-3e-3, 3e-3, 2)] for _ in range(3)]
    if rng.random() < 0.3:  # beyond -0.22 MPa the void's exponent is cut off
        oil[rng.integers(3)][rng.integers(2)] = rng.uniform(-3e5, 0.0)
    if rng.random() < 0.3:  # around the transition flow of edges, and that of hoses in warm oil
        oil[rng.integers(3)][2 + rng.integers(2)] = rng.choice([1e-6, 1e-3]) * rng.uniform(-1.0, 1.0)
    angles = [rng.uniform(-3.0, 3.0), rng.uniform(-0.7, 1.3), rng.uniform(-2.4, -0.4)]
    load = [rng.uniform(0.0, 500.0), rng.uniform(-2e3, 2e3)]
    x = np.array([*oil[0], *oil[1], *oil[2], *angles, *rng.uniform(-1.0, 1.0, 3), *load])
    pressures = [rng.uniform(10e6, 25e6), rng.uniform(0.0, 1e6)]
    kelvin = rng.choice([rng.uniform(253.15, 373.15), rng.uniform(220.0, 430.0)])
    return x, np.array([*rng.uniform(-11.0, 11.0, 3), *pressures, rng.uniform(0.0, 500.0), kelvin])


def samples(count):
    """Random parameters, states and inputs, the same in every run."""
    rng = np.random.default_rng(1998)
    for _ in range(count):
        yield random_numbers(rng), *random_point(rng)


def test_names_and_numbers_are_those_of_the_project(model):
    """Both writings have the same states in the same order, and read the same parameters."""
    assert model.states == transcription.STATES
    np.testing.assert_array_equal(model.nominal, transcription.NOMINAL)
    theirs = dict(zip(model.parameters, model.p.tolist(), strict=True))
    known = transcription.numbers()
    machine, of_hoses = transcription.Machine(known), ("inertance", "capacitance", "resistance")
    derived = {f"swing.line_{n}": getattr(machine.swing, f"line_{n}") for n in of_hoses}
    for name, p in zip(("boom", "stick"), machine.hydraulic, strict=True):
        derived |= {f"boom_stick.{name}_hose_{n}": getattr(p, f"hose_{n}") for n in of_hoses}
    # both evaluate the formulas of hoses and lines: rounding only
    assert {name: theirs.pop(name) for name in derived} == pytest.approx(derived, rel=1e-14, abs=0)
    assert theirs == {name: known[name] for name in theirs}


def test_right_hand_sides_and_observables_agree(model):
    """At random parameters, states and inputs both writings give the same rates, forces and flows."""
    for table, x, u in samples(150):
        machine, known = transcription.Machine(table, u[6]), [table[name] for name in model.parameters]
        ours, _ = transcription.evaluate(machine, x.tolist(), u.tolist())
        theirs = model.right_hand_side(x, u, known).full().ravel()
        # same equations, other order of rounding: a pressure of 2e7 Pa is rounded to 4e-9 Pa, and the
        # swing lines (R C = 2e-6 s) make 1e-2 Pa/s of the sum of some, a fifth of the absolute tolerance
        np.testing.assert_allclose(ours / model.nominal, theirs / model.nominal, rtol=1e-9, atol=5e-9)
        seen = transcription.observe(machine, x.tolist(), u.tolist())
        outputs = dict(zip(model.output_names, model.outputs(x, u, known).full().ravel(), strict=True))
        # rounding as above; the torque rate is a difference of the pressure rates of two stiff lines
        np.testing.assert_allclose([*seen.values()], [outputs[name] for name in seen], rtol=1e-8)


def test_consistent_start_agrees(model):
    """From any pose of the work space both writings start with the same pressures, at rest."""
    rng = np.random.default_rng(9)
    for boom, stick in pose_grid(5):
        table, tank, angles = random_numbers(rng), rng.uniform(0.0, 5e5), [rng.uniform(-3, 3), boom, stick]
        held = rng.choice([0.0, rng.uniform(0.0, 500.0)])
        table |= {f"manipulator.initial_{n}_angle": a for n, a in zip(JOINTS, angles, strict=True)}
        inputs = model.u.copy()
        inputs[4:6] = tank, held
        theirs = np.array(model.start(model.x, inputs, [table[name] for name in model.parameters])).ravel()
        ours = transcription.start(transcription.Machine(table), angles, tank, held)
        # exact identity: rounding only, up to 1e3 of it where the holding force crosses zero
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
