"""Derivatives and dependencies, against small changes of inputs and states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from orchestrator.check.child.binary import Refused
from orchestrator.check.child.description import Variable
from orchestrator.check.child.main import Bench, Said
from orchestrator.check.child.player import Player, Values

SHIFT = 1e-4  # of the magnitude of a variable
KNOWNS = 60  # columns that are looked at
Row = list[float]


class Point:
    """An instance at rest in time, whose inputs and states are shifted one by one."""

    def __init__(self, bench: Bench, player: Player) -> None:
        self.player, declared = player, bench.declared
        derivatives = [declared.variables[d] for d in declared.derivatives if d in declared.variables]
        self.side = bench.side
        floats = [v for v in declared.of("output") if v.is_float and v.variability == "continuous"]
        self.unknowns = [
            v for v in (floats if bench.side == "cs" else [*floats, *derivatives]) if v.size == 1
        ]
        self.unknowns = list({v.name: v for v in self.unknowns}.values())
        self.values = Values(player.instance, self.unknowns)
        self.inputs = [v for v in player.inputs.variables if v.size == 1]
        scalar = all(declared.variables[s].size == 1 for s in declared.states if s in declared.variables)
        self.states = (
            [declared.variables[s] for s in declared.states] if bench.side == "me" and scalar else []
        )
        self.u = dict(
            zip(player.inputs.names, player.inputs.get() if player.inputs.names else [], strict=True)
        )
        self.x = player.exchange.states() if player.exchange else []

    def shifted(self, known: Variable, shift: float) -> Row:
        """Unknowns with one known shifted; everything else as it is."""
        if known in self.states:
            assert self.player.exchange is not None
            x = list(self.x)
            x[self.states.index(known)] += shift
            self.player.exchange.put(self.player.time, x)
            row = self.values.get()
            self.player.exchange.put(self.player.time, self.x)
            return row
        one = Values(self.player.instance, [known])
        one.set([self.u[known.name] + shift])
        row = self.values.get()
        one.set([self.u[known.name]])
        return row

    def allowed(self, known: Variable, shift: float) -> bool:
        """Is the shifted value within its bounds?"""
        if known in self.states:
            return True
        return known.low <= self.u[known.name] + shift <= known.high


def _points(bench: Bench) -> Iterator[Point]:
    """After initialisation, and after a few steps with moving inputs."""
    for steps in (0, 5) if bench.pokes else (0,):
        player = bench.player().begin()
        player.run(steps, poke=True)
        yield Point(bench, player)


def dependencies(bench: Bench) -> Iterator[Said]:
    """What changes with an input or state lists it among its dependencies."""
    told: set[str] = set()
    for point in _points(bench):
        told_here = {u.name for u in point.unknowns if bench.declared.dependencies.get(u.name) is not None}
        for known in [*point.inputs, *point.states][:KNOWNS]:
            for size in (SHIFT, 1e-2):
                changed = _changed(point, known, size * known.scale)
                for name in changed:
                    listed = bench.declared.dependencies.get(name) or frozenset()
                    if name in told_here and known.name not in listed and name not in told:
                        told.add(name)
                        listing = ", ".join(sorted(listed)[:5]) or "none"
                        text = f"{name} changes with {known.name}, its dependencies list {listing}"
                        yield "error", text + (" and more" if len(listed) > 5 else "")


def _changed(point: Point, known: Variable, shift: float) -> list[str]:
    """Names of what changes; nothing when the FMU refuses the value."""
    try:
        if not point.allowed(known, shift):
            return []
        base, moved = point.shifted(known, 0.0), point.shifted(known, shift)
    except Refused:
        return []
    rows = zip(point.unknowns, base, moved, strict=True)
    return [
        v.name
        for v, a, b in rows
        if v is not known and abs(a - b) > 1e-9 * max(abs(a), abs(b), 1e-9 * v.nominal)
    ]


def directional(bench: Bench) -> Iterator[Said]:
    """Directional derivatives equal central differences."""
    for point in _points(bench):
        references = [u.reference for u in point.unknowns]
        if not references:
            return
        for known in [*point.inputs, *point.states][:KNOWNS]:
            exact = point.player.instance.directional(references, known.reference)
            for text in _against_differences(point, known, exact):
                yield "error", text
                return


def _against_differences(point: Point, known: Variable, exact: Sequence[float]) -> Iterator[str]:
    try:
        coarse, fine = (_central(point, known, k * SHIFT * known.scale) for k in (1.0, 0.1))
    except Refused:
        return
    if coarse is None or fine is None:
        return
    if point.side == "cs" and not any(fine):
        return  # an FMU may wait with its outputs until the next step
    for unknown, d, a, b in zip(point.unknowns, exact, coarse, fine, strict=True):
        # the two differences tell how exact they are; the rest is rounding of the larger terms
        slack = 10 * abs(a - b) + 1e-3 * abs(b) + 1e-7 * unknown.nominal / known.scale
        if unknown is not known and not abs(d - b) <= slack:
            text = f"the derivative of {unknown.name} with respect to {known.name} is {d:.6g}"
            yield f"{text}, by differences {b:.6g}"


def _central(point: Point, known: Variable, shift: float) -> Row | None:
    if not point.allowed(known, shift) or not point.allowed(known, -shift):
        return None
    plus, minus = point.shifted(known, shift), point.shifted(known, -shift)
    return [(a - b) / (2 * shift) for a, b in zip(plus, minus, strict=True)]


def adjoint(bench: Bench) -> Iterator[Said]:
    """Adjoint derivatives are the directional ones, row by row."""
    for point in _points(bench):
        knowns = [*point.inputs, *point.states][:KNOWNS]
        references = [k.reference for k in knowns]
        instance = point.player.instance
        if not knowns or not point.unknowns:
            return
        columns = [instance.directional([u.reference for u in point.unknowns], r) for r in references]
        for i, unknown in enumerate(point.unknowns):
            row = instance.adjoint(unknown.reference, references)
            for known, a, column in zip(knowns, row, columns, strict=True):
                # the same products summed in another order
                if not abs(a - column[i]) <= 1e-6 * abs(column[i]) + 1e-9 * unknown.nominal / known.scale:
                    text = f"the adjoint derivative of {unknown.name} with respect to {known.name} is {a:.6g}"
                    yield "error", f"{text}, the directional one {column[i]:.6g}"
                    return


def output_derivatives(bench: Bench) -> Iterator[Said]:
    """Output derivatives are about the slope of the outputs along the run, inputs held."""
    fine = bench.can("canHandleVariableCommunicationStepSize")
    player = bench.player(step=bench.declared.step * (0.1 if fine else 1.0)).begin()
    if bench.pokes:
        player.poke()
    held = player.inputs.get() if player.inputs.names else []
    player.run(10)
    flat = [v for v in player.outputs.variables if smooth(v)]
    if not flat:
        return
    values = Values(player.instance, flat)
    along: list[Row] = []
    told: list[Row] = []
    for _ in range(3):
        if held:  # inputs may move within a step by their rates
            player.inputs.set(held)
        before = values.get()
        player.advance()
        along.append([(b - a) / player.step for a, b in zip(before, values.get(), strict=True)])
        told.append(player.instance.slopes([v.reference for v in flat]))
    for v, d, left, right in zip(flat, told[1], along[1], along[2], strict=True):
        # a solver's tolerance off the slow motion, a stiff model has quite another derivative: no fault
        slack = 3 * abs(right - left) + 0.2 * abs(right) + 1e-5 * v.nominal / player.step
        if not abs(d - (left + right) / 2) <= slack:
            text = f"the derivative of {v.name} is {d:.6g} at t = {player.time - player.step:.6g} s"
            yield "error", f"{text}, its slope along the run {(left + right) / 2:.6g}"
            return


def smooth(v: Variable) -> bool:
    """A scalar with derivatives."""
    return v.is_float and v.variability == "continuous" and v.size == 1
