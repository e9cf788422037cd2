"""The machine to be identified: its numbers and names, and the joint refinement as an estimation problem.

Numbers are kept by `part.name`: those of the parameter files, replaced by what was estimated since. Parameter
files call a parameter `name` where parts do not differ; recordings call a signal `part.name`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches

from fmus.composition import declared, flat_names
from fmus.contract import quantities
from fmus.identification.estimate import Estimate
from fmus.identification.refinement.measured_runs import RecordingMap
from fmus.identification.refinement.problem import EstimationProblem, FreeParameter, free_parameters
from fmus.machine.one_block import HARVESTER, HIDDEN, TOTALS
from fmus.machine.parts import INPUTS, SUBSYSTEMS
from fmus.parameters import Number, Values, derived, numbers, read, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Numbers = Mapping[str, Number]

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


def nominal() -> dict[str, Number]:
    """All parameters of the parts and their variants; with the values of what is derived."""
    return {
        f"{part}.{name}": number
        for part, sub in SUBSYSTEMS.items()
        for name, number in (read(sub.folder / "parameters.toml")["parameters"] | derived(sub)).items()
    }


def targets_of(name: str, known: Numbers) -> list[str]:
    """The parameters, `part.name`, that a name stands for: a bare one for those of every part."""
    return [full for full in known if name in (full, full.partition(".")[2])]


def short_name(name: str, known: Numbers) -> str:
    """The shortest name that means the same parameters: without part where parts do not differ."""
    bare = name.rpartition(".")[2]
    return bare if targets_of(bare, known) == targets_of(name, known) else name


def lookup(name: str, known: Numbers) -> Number:
    """The number of a name, with or without part."""
    return known[targets_of(name, known)[0]]


def updated(known: Numbers, estimates: Iterable[Estimate]) -> dict[str, Number]:
    """With estimates in the place of what was known: a bare name goes to every part that has it."""
    result = dict(known)
    for estimate in estimates:
        targets = targets_of(estimate.name, known)
        if not targets:
            raise Problem(f"{estimate.name} was estimated, expected a parameter of the machine")
        result |= dict.fromkeys(targets, estimate.number())
    return result


def _flat() -> dict[str, str]:
    """`part.name` -> variable of `HARVESTER`."""
    tables = {name: numbers(sub) for name, sub in SUBSYSTEMS.items()}
    return dict(flat_names(SUBSYSTEMS, tables, INPUTS, TOTALS, HIDDEN))


def signals() -> dict[str, str]:
    """Input or output of `HARVESTER` -> the signal of a recording, such as "swing.supply_pressure"."""
    names = {own: targets[0] for own, targets in INPUTS.items()}
    flat, outputs = _flat(), quantities(HARVESTER.outputs)
    for variable in declared(SUBSYSTEMS, "outputs"):
        if variable in flat and flat[variable] in outputs:
            names.setdefault(flat[variable], variable)
    return names


def parameters() -> dict[str, str]:
    """Parameter of `HARVESTER` -> its name in parameters.toml, `part.name` where parts differ."""
    flat, names = _flat(), {}
    for variable in declared(SUBSYSTEMS, "parameters"):
        own = variable.partition(".")[2]
        names[flat[variable]] = own if flat[variable] == own else variable
    return names


def checked(names: Sequence[str]) -> dict[str, str]:
    """The parameters of the one block by the names of parameters.toml, if all `names` are among them."""
    own = {name: flat for flat, name in parameters().items()}
    for name in names:
        if name not in own:
            near = get_close_matches(name, own, 1) or [", ".join(sorted(own))]
            raise Problem(f"{name} is to be refined, expected a parameter of the machine: {near[0]}")
    return own


def problem(
    recordings: Sequence[Recording], known: Numbers, names: Sequence[str] = FREE
) -> EstimationProblem:
    """The machine against all its recordings; those with use "test" are held out.

    names   free parameters, as parameters.toml calls them

    A parameter's prior is its number, with the standard deviation of a measurement before or `UNKNOWN`.
    """
    own, names_of_signals = checked(names), signals()
    for recording in recordings:
        for command in COMMANDS:
            _ = recording[
                names_of_signals[command]
            ]  # a drive without its command would be taken to stand still
    usual = values(HARVESTER)
    fixed = Values({flat: lookup(n, known).value for flat, n in parameters().items()}, usual.u, usual.x)
    priors: dict[str, tuple[float, float | None]] = {}
    for name in names:
        number = lookup(name, known)
        priors[own[name]] = (number.value, number.sd or UNKNOWN * abs(number.value) or None)
    moving = ("_speed", "_flow", "_flow_a", "_flow_b")
    mapping = RecordingMap(
        HARVESTER,
        outputs=_measured_outputs(recordings),
        signals=names_of_signals,
        smooth=SMOOTH,
        rest=[n for n in quantities(HARVESTER.states) if n.endswith(moving)],
        values=fixed,
    )
    runs = {use: [mapping.run(r) for r in recordings if r.use == use] for use in ("train", "test")}
    return EstimationProblem(
        sub=HARVESTER,
        outputs=tuple(mapping.outputs),
        free=_within_ten(free_parameters(HARVESTER, [own[n] for n in names], priors, fixed)),
        training=tuple(runs["train"]),
        held_out=tuple(runs["test"]),
        fixed=fixed,
    )


def _within_ten(free: Collection[FreeParameter]) -> tuple[FreeParameter, ...]:
    """A factor of ten around the value on a logarithmic scale is all that a search may try."""
    return tuple(
        replace(f, low=max(f.low, f.value / 10), high=min(f.high, f.value * 10)) if f.log else f for f in free
    )


def _measured_outputs(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Outputs that a training recording has a sensor for."""
    training = [r for r in recordings if r.use == "train"]
    if not training:
        raise Problem("joint refinement: expected a recording of the machine to train with, found none")
    names = signals()
    outputs = [n for n in quantities(HARVESTER.outputs) if n in names]
    measured = tuple(n for n in outputs if any(names[n] in r.signals for r in training))
    if not measured:
        wanted = ", ".join(names[n] for n in outputs)
        raise Problem(f"{training[0].source}: nothing to compare is measured, expected one of {wanted}")
    return measured


def assumptions(recordings: Sequence[Recording]) -> list[str]:
    """What is not measured and taken as constant, a sentence each."""
    supply, constant = signals()["supply_pressure"], values(HARVESTER).u["supply_pressure"]
    return [
        f"{r.source.name}: the supply pressure is not measured, taken as {constant / 1e5:g} bar throughout"
        for r in recordings
        if supply not in r.signals
    ]
