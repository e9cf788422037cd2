"""Tasks that compare derivatives and dependencies of an FMU with finite differences."""

from collections.abc import Iterator, Sequence

import numpy as np

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation, Vector, numeric, usual_step
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import CallFailed

SHIFT = 1e-4  # relative to the magnitude of a variable
MAX_KNOWNS = 60  # inputs and states that are shifted


class ShiftedPoint:
    """An instance at a fixed time, whose inputs and states are shifted one by one."""

    def __init__(self, trial: Trial, simulation: Simulation) -> None:
        self.simulation, description = simulation, trial.description
        model_exchange = trial.kind == "ModelExchange"
        unknowns = [v for v in numeric(description, "output") if smooth(v)]
        unknowns += [v for v in description.derivatives if v.size == 1] if model_exchange else []
        self.unknowns = list(dict.fromkeys(unknowns))
        self.values = simulation.values(self.unknowns)
        self.inputs = [v for v in simulation.inputs.variables if v.size == 1]
        scalar = all(v.size == 1 for v in description.states)
        self.states = list(description.states) if model_exchange and scalar else []
        self.u = dict(zip(simulation.inputs.names, simulation.inputs.get(), strict=True))
        self.x = simulation.integrator.states() if simulation.integrator else np.zeros(0)

    @property
    def knowns(self) -> list[FmuVariable]:
        """The inputs and states that are shifted."""
        return [*self.inputs, *self.states][:MAX_KNOWNS]

    def shifted(self, known: FmuVariable, shift: float) -> Vector:
        """The unknowns with one known shifted and all others unchanged."""
        integrator, time = self.simulation.integrator, self.simulation.time
        if integrator is not None and known in self.states:
            x = self.x.copy()
            x[self.states.index(known)] += shift
            try:
                integrator.set_time_and_states(time, x)
                return self.values.get()
            finally:
                integrator.set_time_and_states(time, self.x)
        value = self.simulation.values([known])
        try:
            value.set([self.u[known.name] + shift])
            return self.values.get()
        finally:
            value.set([self.u[known.name]])

    def allowed(self, known: FmuVariable, shift: float) -> bool:
        """The shifted value is within its bounds."""
        low, high = known.bounds
        return known in self.states or low <= self.u[known.name] + shift <= high


def _points(trial: Trial) -> Iterator[ShiftedPoint]:
    """The point after initialisation, and the point after a few steps with perturbed inputs."""
    for steps in (0, 5) if trial.perturbable else (0,):
        simulation = Simulation(trial).begin()
        simulation.run(steps, perturb=True)
        yield ShiftedPoint(trial, simulation)


def dependencies(trial: Trial) -> Iterator[Remark]:
    """An output or derivative that changes with an input or state declares this dependency."""
    entries = (u for section in ("outputs", "derivatives") for u in trial.description.structure[section])
    declared = {u.variable: u.dependencies for u in entries if u.variable and u.dependencies is not None}
    by_key, reported = trial.description.by_key, set[FmuVariable]()
    for point in _points(trial):
        for known in point.knowns:
            for size in (SHIFT, 1e-2):
                for v in _changed(point, known, size * known.scale):
                    names = {by_key[k].name for k in declared.get(v, ()) if k is not None and k in by_key}
                    if v not in declared or known.name in names or v in reported:
                        continue
                    reported.add(v)
                    text = f"{v.name} changes with {known.name}, its declared dependencies are"
                    more = " and more" if len(names) > 5 else ""
                    yield "error", f"{text} {', '.join(sorted(names)[:5]) or 'none'}{more}"


def _changed(point: ShiftedPoint, known: FmuVariable, shift: float) -> list[FmuVariable]:
    """The unknowns that change; none if the FMU rejects the value."""
    try:
        if not point.allowed(known, shift):
            return []
        base, shifted = point.shifted(known, 0.0), point.shifted(known, shift)
    except CallFailed:
        return []
    magnitude = np.maximum.reduce([np.abs(base), np.abs(shifted), 1e-9 * point.values.nominal])
    changes = np.abs(base - shifted) > 1e-9 * magnitude
    return [v for v, changed in zip(point.unknowns, changes, strict=True) if changed and v is not known]


def directional(trial: Trial) -> Iterator[Remark]:
    """Directional derivatives equal central differences, or are between those of the two sides of a kink."""
    for point in _points(trial):
        references = [u.reference or 0 for u in point.unknowns]
        if not references:
            return
        for known in point.knowns:
            exact = point.simulation.instance.directional(references, known.reference)
            for text in _against_differences(point, known, exact):
                yield "error", text
                return


def _against_differences(point: ShiftedPoint, known: FmuVariable, exact: Sequence[float]) -> Iterator[str]:
    try:
        coarse, fine = (_differences(point, known, k * SHIFT * known.scale) for k in (1.0, 0.1))
    except CallFailed:
        return
    if coarse is None or fine is None:
        return
    if point.simulation.integrator is None and not fine.any():
        return  # an FMU may compute its outputs only in the next step
    for unknown, d, wide, sides in zip(point.unknowns, exact, coarse.T, fine.T, strict=True):
        a, b = wide.mean(), sides.mean()
        # the two differences show their truncation error; the last term is rounding
        tolerance = 10 * abs(a - b) + 1e-3 * abs(b) + 1e-7 * unknown.magnitude / known.scale
        if unknown is not known and not min(sides) - tolerance <= d <= max(sides) + tolerance:
            text = f"the derivative of {unknown.name} with respect to {known.name} is {d:.6g}"
            yield f"{text}, by finite differences {b:.6g}"


def _differences(point: ShiftedPoint, known: FmuVariable, shift: float) -> Vector | None:
    """Difference quotients to the left and to the right, shape (2, unknowns); None beyond the bounds."""
    if not point.allowed(known, shift) or not point.allowed(known, -shift):
        return None
    return np.diff([point.shifted(known, k * shift) for k in (-1, 0, 1)], axis=0) / shift


def adjoint(trial: Trial) -> Iterator[Remark]:
    """Adjoint derivatives equal directional derivatives, row by row of the Jacobian."""
    for point in _points(trial):
        knowns = point.knowns
        references = [k.reference or 0 for k in knowns]
        instance = point.simulation.instance
        if not knowns or not point.unknowns:
            return
        columns = [instance.directional([u.reference or 0 for u in point.unknowns], r) for r in references]
        for i, unknown in enumerate(point.unknowns):
            row = instance.adjoint(unknown.reference, references)
            for known, a, column in zip(knowns, row, columns, strict=True):
                # the same products summed in another order
                if not abs(a - column[i]) <= 1e-6 * abs(column[i]) + 1e-9 * unknown.magnitude / known.scale:
                    text = f"the adjoint derivative of {unknown.name} with respect to {known.name} is {a:.6g}"
                    yield "error", f"{text}, the directional one {column[i]:.6g}"
                    return


def output_derivatives(trial: Trial) -> Iterator[Remark]:
    """Output derivatives are near the difference quotients of a run with constant inputs."""
    variable_step = trial.interface.declares("canHandleVariableCommunicationStepSize")
    simulation = Simulation(
        trial, step=usual_step(trial.description) * (0.1 if variable_step else 1.0)
    ).begin()
    if trial.perturbable:
        simulation.perturb()
    inputs = simulation.inputs.get()
    simulation.run(10)
    outputs = [v for v in simulation.outputs.variables if smooth(v)]
    if not outputs:
        return
    values = simulation.values(outputs)
    quotients: list[Vector] = []
    derivatives: list[list[float]] = []
    for _ in range(3):
        simulation.inputs.set(inputs)  # inputs may change within a step by their rates
        before = values.get()
        simulation.advance()
        quotients.append((values.get() - before) / simulation.step)
        derivatives.append(simulation.instance.output_derivatives([v.reference for v in outputs]))
    for v, d, left, right in zip(outputs, derivatives[1], quotients[1], quotients[2], strict=True):
        # the derivative of a stiff model differs a lot at states that are off by the solver's tolerance
        tolerance = 3 * abs(right - left) + 0.2 * abs(right) + 1e-5 * v.magnitude / simulation.step
        if not abs(d - (left + right) / 2) <= tolerance:
            text = f"the derivative of {v.name} is {d:.6g} at t = {simulation.time - simulation.step:.6g} s"
            yield "error", f"{text}, the difference quotient of the run {(left + right) / 2:.6g}"
            return


def smooth(v: FmuVariable) -> bool:
    """A continuous real scalar."""
    return v.is_continuous and v.size == 1
