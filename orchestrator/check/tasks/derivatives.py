"""Derivatives and dependencies, against small changes of inputs and states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, numeric, usual_step
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.raw_description import DeclaredVariable

SHIFT = 1e-4  # of the magnitude of a variable
KNOWNS = 60  # columns that are looked at
Row = list[float]


class ShiftedPoint:
    """An instance that rests in time, whose inputs and states are shifted one by one."""

    def __init__(self, trial: Trial, simulation: Simulation) -> None:
        self.simulation, description = simulation, trial.description
        exchange = trial.kind == "ModelExchange"
        unknowns = [v for v in numeric(description, "output") if smooth(v)]
        unknowns += [v for v in description.derivatives if v.size == 1] if exchange else []
        self.unknowns = list(dict.fromkeys(unknowns))
        self.values = simulation.values(self.unknowns)
        self.inputs = [v for v in simulation.inputs.variables if v.size == 1]
        scalar = all(v.size == 1 for v in description.states)
        self.states = list(description.states) if exchange and scalar else []
        self.u = dict(zip(simulation.inputs.names, simulation.inputs.get(), strict=True))
        self.x = simulation.exchange.states() if simulation.exchange else []

    @property
    def knowns(self) -> list[DeclaredVariable]:
        """The inputs and states that are shifted."""
        return [*self.inputs, *self.states][:KNOWNS]

    def shifted(self, known: DeclaredVariable, shift: float) -> Row:
        """Unknowns with one known shifted; everything else as it is."""
        exchange, time = self.simulation.exchange, self.simulation.time
        if exchange is not None and known in self.states:
            x = list(self.x)
            x[self.states.index(known)] += shift
            exchange.put(time, x)
            row = self.values.get()
            exchange.put(time, self.x)
            return row
        one = self.simulation.values([known])
        one.set([self.u[known.name] + shift])
        row = self.values.get()
        one.set([self.u[known.name]])
        return row

    def allowed(self, known: DeclaredVariable, shift: float) -> bool:
        """Is the shifted value within its bounds?"""
        return known in self.states or known.minimum <= self.u[known.name] + shift <= known.maximum


def _points(trial: Trial) -> Iterator[ShiftedPoint]:
    """After initialisation, and after a few steps with moving inputs."""
    for steps in (0, 5) if trial.pokes else (0,):
        simulation = Simulation(trial).begin()
        simulation.run(steps, poke=True)
        yield ShiftedPoint(trial, simulation)


def dependencies(trial: Trial) -> Iterator[Remark]:
    """What changes with an input or state lists it among its dependencies."""
    entries = (u for section in ("outputs", "derivatives") for u in trial.description.structure[section])
    listed = {u.variable: u.dependencies for u in entries if u.variable and u.dependencies is not None}
    by_key, reported = trial.description.by_key, set[DeclaredVariable]()
    for point in _points(trial):
        for known in point.knowns:
            for size in (SHIFT, 1e-2):
                for v in _changed(point, known, size * known.scale):
                    given = {by_key[k].name for k in listed.get(v, ()) if k is not None and k in by_key}
                    if v not in listed or known.name in given or v in reported:
                        continue
                    reported.add(v)
                    text = f"{v.name} changes with {known.name}, its dependencies list"
                    more = " and more" if len(given) > 5 else ""
                    yield "error", f"{text} {', '.join(sorted(given)[:5]) or 'none'}{more}"


def _changed(point: ShiftedPoint, known: DeclaredVariable, shift: float) -> list[DeclaredVariable]:
    """What changes; nothing when the FMU refuses the value."""
    try:
        if not point.allowed(known, shift):
            return []
        base, moved = point.shifted(known, 0.0), point.shifted(known, shift)
    except CallFailed:
        return []
    rows = zip(point.unknowns, base, moved, strict=True)
    return [
        v for v, a, b in rows if v is not known and abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-9 * v.nominal)
    ]


def directional(trial: Trial) -> Iterator[Remark]:
    """Directional derivatives equal central differences."""
    for point in _points(trial):
        references = [u.reference or 0 for u in point.unknowns]
        if not references:
            return
        for known in point.knowns:
            exact = point.simulation.instance.directional(references, known.reference or 0)
            for text in _against_differences(point, known, exact):
                yield "error", text
                return


def _against_differences(
    point: ShiftedPoint, known: DeclaredVariable, exact: Sequence[float]
) -> Iterator[str]:
    try:
        coarse, fine = (_central(point, known, k * SHIFT * known.scale) for k in (1.0, 0.1))
    except CallFailed:
        return
    if coarse is None or fine is None:
        return
    if point.simulation.exchange is None and not any(fine):
        return  # an FMU may wait with its outputs until the next step
    for unknown, d, a, b in zip(point.unknowns, exact, coarse, fine, strict=True):
        # the two differences tell how exact they are; the rest is rounding of the larger terms
        slack = 10 * abs(a - b) + 1e-3 * abs(b) + 1e-7 * unknown.nominal / known.scale
        if unknown is not known and not abs(d - b) <= slack:
            text = f"the derivative of {unknown.name} with respect to {known.name} is {d:.6g}"
            yield f"{text}, by differences {b:.6g}"


def _central(point: ShiftedPoint, known: DeclaredVariable, shift: float) -> Row | None:
    if not point.allowed(known, shift) or not point.allowed(known, -shift):
        return None
    plus, minus = point.shifted(known, shift), point.shifted(known, -shift)
    return [(a - b) / (2 * shift) for a, b in zip(plus, minus, strict=True)]


def adjoint(trial: Trial) -> Iterator[Remark]:
    """Adjoint derivatives are the directional ones, row by row."""
    for point in _points(trial):
        knowns = point.knowns
        references = [k.reference or 0 for k in knowns]
        instance = point.simulation.instance
        if not knowns or not point.unknowns:
            return
        columns = [instance.directional([u.reference or 0 for u in point.unknowns], r) for r in references]
        for i, unknown in enumerate(point.unknowns):
            row = instance.adjoint(unknown.reference or 0, references)
            for known, a, column in zip(knowns, row, columns, strict=True):
                # the same products summed in another order
                if not abs(a - column[i]) <= 1e-6 * abs(column[i]) + 1e-9 * unknown.nominal / known.scale:
                    text = f"the adjoint derivative of {unknown.name} with respect to {known.name} is {a:.6g}"
                    yield "error", f"{text}, the directional one {column[i]:.6g}"
                    return


def output_derivatives(trial: Trial) -> Iterator[Remark]:
    """Output derivatives are about the slope of the outputs along the run, inputs held."""
    fine = trial.able.declares("canHandleVariableCommunicationStepSize")
    simulation = Simulation(trial, step=usual_step(trial.description) * (0.1 if fine else 1.0)).begin()
    if trial.pokes:
        simulation.poke()
    held = simulation.inputs.get()
    simulation.run(10)
    outputs = [v for v in simulation.outputs.variables if smooth(v)]
    if not outputs:
        return
    values = simulation.values(outputs)
    along: list[Row] = []
    given: list[Row] = []
    for _ in range(3):
        simulation.inputs.set(held)  # inputs may move within a step by their rates
        before = values.get()
        simulation.advance()
        along.append([(b - a) / simulation.step for a, b in zip(before, values.get(), strict=True)])
        given.append(simulation.instance.output_derivatives([v.reference or 0 for v in outputs]))
    for v, d, left, right in zip(outputs, given[1], along[1], along[2], strict=True):
        # a solver's tolerance off the slow motion, a stiff model has quite another derivative: no fault
        slack = 3 * abs(right - left) + 0.2 * abs(right) + 1e-5 * v.nominal / simulation.step
        if not abs(d - (left + right) / 2) <= slack:
            text = f"the derivative of {v.name} is {d:.6g} at t = {simulation.time - simulation.step:.6g} s"
            yield "error", f"{text}, its slope along the run {(left + right) / 2:.6g}"
            return


def smooth(v: DeclaredVariable) -> bool:
    """A scalar with derivatives."""
    return v.is_float and v.variability == "continuous" and v.size == 1
