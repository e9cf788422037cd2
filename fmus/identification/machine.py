"""The joint refinement of the machine: which parameters, which signals, what is known before."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from difflib import get_close_matches

from fmus.contract import quantities
from fmus.identification.known import Known, lookup
from fmus.identification.refinement.data import Mapped
from fmus.identification.refinement.problem import (
    EstimationProblem,
    Free,
    free_parameters,
    parameters,
    signals,
)
from fmus.machine.one_block import HARVESTER
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

# What a work cycle shows. Left out, because it hardly does or because something else stands for them:
# inertances and resistances of the swing's lines (their time is below a millisecond), rounding and leakage of
# the valve, inertances of the hoses, geometry, displacement of the motor (read off a type plate).
FREE = (
    "valve_area",
    "valve_dead_band",
    "line_capacitance",
    "internal_leakage_resistance",
    "external_leakage_resistance",
    "boom_hose_capacitance",
    "boom_hose_resistance",
    "stick_hose_capacitance",
    "stick_hose_resistance",
    "column_inertia",
    "boom_mass",
    "stick_mass",
    "stick_inertia",
    "head_mass",
    "swing_damping",
    "boom_piston_damping",
    "stick_piston_damping",
)
UNKNOWN = 0.3  # relative sd of a number that nobody measured: literature and free choices are that far apart
COMMANDS = ("swing_command", "boom_command", "stick_command")
SMOOTH = {"supply_pressure": 20.0}  # s, or as long as it takes no more than the noise of the sensor off


def problem(recordings: Sequence[Recording], known: Known, names: Sequence[str] = FREE) -> EstimationProblem:
    """The machine against all its recordings; those with use "test" are held out.

    names   free parameters, as parameters.toml calls them
    """
    own = checked(names)
    for recording in recordings:
        for command in COMMANDS:
            _ = recording[signals()[command]]  # a drive without its command would be taken to stand still
    numbers = fixed(known)
    free = [own[name] for name in names]
    priors = {own[name]: _prior(known, name) for name in names}
    mapped = Mapped(
        HARVESTER,
        outputs=_measured(recordings),
        signals=signals(),
        smooth=SMOOTH,
        rest=[
            n for n in quantities(HARVESTER.states) if n.endswith(("_speed", "_flow", "_flow_a", "_flow_b"))
        ],
        numbers=numbers,
    )
    runs = {use: [mapped.run(r) for r in recordings if r.use == use] for use in ("train", "test")}
    return EstimationProblem(
        sub=HARVESTER,
        outputs=tuple(mapped.outputs),
        free=bounded(free_parameters(HARVESTER, free, priors, numbers)),
        training=tuple(runs["train"]),
        held_out=tuple(runs["test"]),
        fixed=numbers,
    )


def assumed(recordings: Sequence[Recording]) -> list[str]:
    """What is not measured and taken as constant, a sentence each."""
    names, usual = signals(), values(HARVESTER).u
    without = [r.source.name for r in recordings if names["supply_pressure"] not in r.signals]
    constant = f"{usual['supply_pressure'] / 1e5:g} bar"
    return [f"{n}: the supply pressure is not measured, taken as {constant} throughout" for n in without]


def checked(names: Sequence[str]) -> dict[str, str]:
    """The parameters of the one block by the names of parameters.toml, if all `names` are among them."""
    own = {name: flat for flat, name in parameters().items()}
    for name in names:
        if name not in own:
            near = get_close_matches(name, own, 1) or [", ".join(sorted(own))]
            raise Problem(f"{name} is to be refined, expected a parameter of the machine: {near[0]}")
    return own


def fixed(known: Known) -> Values:
    """The numbers of the one block."""
    usual = values(HARVESTER)
    return Values({flat: lookup(name, known).value for flat, name in parameters().items()}, usual.u, usual.x)


def bounded(free: Collection[Free]) -> tuple[Free, ...]:
    """A factor of ten around the value on a logarithmic scale is all that a search may try."""
    return tuple(
        replace(f, low=max(f.low, f.value / 10), high=min(f.high, f.value * 10)) if f.log else f for f in free
    )


def _prior(known: Known, name: str) -> tuple[float, float | None]:
    """Value and its standard deviation: of a measurement before, else as wide as free choices are."""
    number = lookup(name, known)
    return number.value, number.sd if number.sd else UNKNOWN * abs(number.value) or None


def _measured(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Outputs that a training recording has a sensor for."""
    training = [r for r in recordings if r.use == "train"]
    if not training:
        raise Problem("joint refinement: expected a recording of the machine to train with, found none")
    names = signals()
    outputs = [n for n in quantities(HARVESTER.outputs) if n in names]
    found = tuple(n for n in outputs if any(names[n] in r.signals for r in training))
    if not found:
        wanted = ", ".join(names[n] for n in outputs)
        source = training[0].source
        raise Problem(f"{source}: nothing to compare is measured, expected one of {wanted}")
    return found
