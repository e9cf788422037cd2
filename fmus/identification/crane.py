"""Identification of a crane of one's own from logs of its functions: `harvester identify --crane`.

Each driven joint has a flow balance (`procedures.flow_balance`): valve, leakage. The cylinders together have
the momentum balance of the arm (`procedures.momentum_balance`), with mechanics and drives of the crane:
masses of the links, friction. A mass has a prior of `PRIOR` of its value in the file, so one that the logs
tell only together with others keeps a wide interval, and is no estimate; the torque of all at the start pose
is one.

Validity: no payload, no contact with the ground; passive joints without a reading hang at rest, else masses
are refused; spool valves. The signals have the names of the crane's FMUs, such as boom_command, boom_angle
and boom_head_pressure, also COMPONENT.NAME or NAME_measured, as for `harvester diagnose`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np
from scipy import stats

from fmus.crane.axes import at_start
from fmus.crane.description import CraneDescription
from fmus.crane.machine import drives, edge_curves
from fmus.crane.manipulator import manipulator, resting
from fmus.identification import balance
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import momentum_balance as momentum
from fmus.identification.procedures.flow_balance import EDGES, IN, LINES, NOTE, OUT, PRIOR, Function
from fmus.identification.procedures.procedure import (
    Contradicted,
    Fit,
    NotAsked,
    Parts,
    Procedure,
    Recordings,
    solve,
)
from fmus.identification.recordings.clock import resample_uniformly
from fmus.identification.recordings.masks import KNOWN, step
from fmus.identification.recordings.reading import TABLES, doubtful, require
from fmus.identification.report.figures import procedure_figures
from fmus.identification.results import Estimate, Panel, ProcedureResult, named
from fmus.parameters import Number, complete, write
from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import tell_once
from orchestrator.base.text import TextTable, first_names
from orchestrator.data.recording import Recording, read_recording
from orchestrator.data.table import READABLE, Array
from orchestrator.results.diagnosis import columns_of
from orchestrator.results.report import PAGE, TERMINAL, Columns, Figure, Part, Report, Section, Table, Text

SLOW, ROUNDING = 0.2, 0.05  # rms speeds: below, stiction holds unknown forces; of the sign of a dry friction
UNLIKE = "; does it move, and are its signs, zeros and pressures those of the description?"
MOVES, NOISES = {"rad": 0.01, "m": 0.01}, 10.0  # of a coordinate, and of a sensor: range of one that moves
ENOUGH = 0.5  # of the quantities of functions that move: with fewer, a log is not what was asked for
IMPLAUSIBLE = 1e9  # times usual magnitudes: no unit explains it
EACH, REST = 5.0, 10.0  # s of a log: of motion of each function, and of rest
RECORD = "each function out and in, over most of its stroke, at small and large commands"


def moved(r: Recording, name: str) -> bool:
    """Whether a reading changes by more than its noise; also one without samples, which the fit refuses."""
    values = r[name][np.isfinite(r[name])]
    least = max(NOISES * np.nan_to_num(data.noise_sd(r, name)), MOVES.get(r.units[name], 0.0))
    return not values.size or bool(np.ptp(values) > least)


def _plausible(log: Recording) -> Recording:
    """With gaps in place of what no sensor reads, such as an overflow of a logger; a line tells it."""
    signals = dict[str, Array]()
    for n, values in log.signals.items():
        largest = max(TABLES["quantities"].get(log.units[n], {}).get("usual", ()), default=np.inf)
        signals[n] = np.where(wrong := np.abs(values) > IMPLAUSIBLE * largest, np.nan, values)
        if wrong.any():
            peak, count = np.abs(values[wrong]).max(), f"{np.sum(wrong)} of {wrong.size} samples left out"
            told = f"{count}, up to {peak:.3g} {log.units[n]}: no sensor reads that"
            tell_once(f"warning: {log.source}: {n}: {told}")
    return replace(log, signals=signals)


@dataclass(frozen=True, eq=False)
class Crane:
    """A crane as an object of identification."""

    description: CraneDescription

    @cached_property
    def arm(self) -> momentum.MeasuredArm:
        """With quasi-static drives that have the leakage of worn ones."""
        crane, pose = self.description, at_start(self.description)
        parts = {j.part: [other for other in crane.driven if other.part == j.part] for j in crane.driven}
        every = tuple(drives(crane, n, of, pose, "quasistatic", True) for n, of in parts.items())
        return momentum.MeasuredArm(every, manipulator(crane))

    @cached_property
    def known(self) -> dict[str, Number]:
        """`part.name` -> value by the description."""
        parts = (*self.arm.drives, self.arm.manipulator)
        return {f"{s.name}.{n}": x for s in parts for n, x in complete(s)["parameters"].items()}

    @cached_property
    def functions(self) -> list[Function]:
        """The driven joints."""
        supply = self.description.numbers["supply"]
        pressures = supply["pressure_setting"].value, supply["reservoir_pressure"].value
        lines = dict(zip(LINES, pressures, strict=True))
        return [Function(self.arm, joint, self.known, lines) for joint in self.arm.pressures]

    @cached_property
    def resting(self) -> tuple[ca.Function, list[str]]:
        """See `fmus.crane.manipulator.resting`."""
        return resting(self.arm.manipulator)

    def read(self, path: Path) -> list[Recording]:
        """A log, or those in a folder, with the names of the signals that are needed; warns of units."""
        files = [path]
        if path.is_dir():
            files = sorted(p for p in path.iterdir() if p.suffix.lower() in READABLE)
        if not files:
            raise Problem(f"{path}: expected logs, files that end in {', '.join(READABLE)}, got none")
        logs = [resample_uniformly(_plausible(self._renamed(read_recording(p)))) for p in files]
        for log in logs:
            momentum.smoothing(log)  # long enough
        for text in doubtful(logs):
            tell_once(f"warning: {text}")
        return [*map(self._complete, logs)]

    def _renamed(self, log: Recording) -> Recording:
        """The signals that are needed, by their names; refuses wrong units."""
        units, columns = self.arm.signals | dict.fromkeys(LINES, "Pa"), dict[str, str]()
        for f in self.functions:
            units |= f.signals
        for name in units:
            part, _, short = name.rpartition(".")
            if found := columns_of([short], part, log.signals, log.source):
                columns[name] = found[short]
        if not columns:
            expected = ", ".join(n.rpartition(".")[2] for n in self.functions[-1].signals)
            got = first_names(log.signals)
            raise Problem(f"{log.source}: expected columns such as {expected}, got none, only {got}")
        log = replace(
            log,
            signals={n: log.signals[c] for n, c in columns.items()},
            units={n: log.units[c] or units[n] for n, c in columns.items()},  # without one SI, as of a run
            file_units={n: x for n, c in columns.items() if (x := log.file_units.get(c))},
            sensors={n: log.sensors[c] for n, c in columns.items() if c in log.sensors},
            faults={n: log.faults[c] for n, c in columns.items() if c in log.faults},
        )
        require(log, {n: units[n] for n in columns})
        return log

    def _complete(self, log: Recording) -> Recording:
        """With steps of readings that no file describes, and passive joints without a reading at rest."""
        read = [n for n in log.signals if not n.endswith("command") and not log.sensor(n).sd]
        steps = {n: replace(log.sensor(n), resolution=step(log.signals[n])) for n in read}
        log, angles = replace(log, sensors={**log.sensors, **steps}), self.arm.angles
        lacking = {n for n in angles if n not in log.signals}
        driven = {n for n, j in zip(angles, self.arm.joints, strict=True) if j in self.arm.pressures}
        if not lacking or lacking & driven:
            return log
        guess = [np.zeros(log.time.size) if n in lacking else log.interpolated(n) for n in angles]
        at_rest = np.array(self.resting[0].map(log.time.size)(np.array(guess))[0])
        hanging = {n: at_rest[k] for k, n in enumerate(angles) if n in lacking}
        units = {n: self.arm.signals[n] for n in hanging}
        return replace(log, signals={**log.signals, **hanging}, units={**log.units, **units})

    @cached_property
    def masses(self) -> Procedure:
        """The momentum balances of all cylinders that move."""
        arm, (rest, names) = self.arm, self.resting
        links = [f"manipulator.{n}" for n in names]
        friction = {j: [n for n in (arm.damping(j),) if n in self.known] for j in arm.cylinders}
        start = {n: self.known[n].value for n in [*links, *(n for some in friction.values() for n in some)]}
        further = momentum.DRY, momentum.OFFSET, momentum.RIPPLE
        dry, offsets, ripple = ({f"{j} {n}": 0.0 for j in arm.cylinders} for n in further)
        commands = {f.joint: f.parameter("command") for f in self.functions}
        readings = [n for j in arm.cylinders for n in arm.pressures[j]]

        def parts(tests: Recordings, _: object) -> Parts:
            p, found = arm.vector(self.known), []
            for r, j in ((r, j) for r in tests for j in arm.cylinders):
                own = arm.angles[arm.index(j)], *arm.pressures[j]
                if {*own} <= r.signals.keys() and all(moved(r, n) for n in own):
                    theta = (*links, *friction[j])
                    u = commands[j] if commands[j] in r.signals and moved(r, commands[j]) else ""
                    s = momentum.joint_samples(
                        r, j, theta, p, slow=SLOW, rounding=ROUNDING, arm=arm, command=u
                    )
                    further = (f"{j} {n}" for n in s.law.unknowns[len(theta) :])
                    found.append(data.with_course(r, replace(s, names=(*theta, *further))))
            if not found:
                raise NotAsked("expected a cylinder that moves, with readings of both pressures, got none")
            return found

        def rippled(fit: Fit, fitted: Callable[[Procedure], Fit]) -> Fit:
            """With forces that follow the command, where the data show them."""
            of = [n for n in ripple if any(n in s.names for s in fit.solution.samples)]
            columns = np.array([fit.solution.column(n) for n in of])
            if not of:
                return fit
            values, covariance = fit.solution.effects(columns)
            p = stats.chi2.sf(values @ np.linalg.pinv(covariance) @ values, len(of))
            return fitted(replace(fit.procedure, tested=[*offsets])) if p < balance.UNLIKELY else fit

        def fitting(fit: Fit) -> None:
            if (times := fit.solution.fit.times_noise) > KNOWN:
                told = f"residuals of {times:.3g} times the noise, expected {KNOWN:g} at most"
                raise Contradicted(f"{told}, such as of a load that swings: move slowly, or record its angle")

        def determined(fit: Fit) -> list[str]:
            return [n for n in start if fit.sd(n) <= balance.DETERMINED * PRIOR * start[n]]

        def estimates(fit: Fit) -> Iterator[Estimate]:
            note = "momentum balance of the cylinders"
            for n in determined(fit):
                yield Estimate.normal(n, fit[n], self.known[n].unit, fit.sd(n), note)
            pose = at_start(self.description)
            torques = np.array(rest([pose[n.partition(".")[2]] for n in arm.angles])[1])
            for j in arm.cylinders:
                weights = dict(zip(links, torques[arm.index(j)], strict=True))
                unit = "N.m" if arm.signals[arm.angles[arm.index(j)]] == "rad" else "N"
                name, how = f"{j} torque of the weight", "at the start pose of the file"
                value, sd = fit.solution.fit.combination(weights)
                yield Estimate.normal(name, value, unit, sd, how)

        def panels(fit: Fit) -> Iterator[Panel]:
            for n in (n for n in determined(fit) if n in links):
                yield from fit.line(Panel("torque per mass", "torque", (), n, y_unit=("kN.m", 1e3)), n)

        def remarks(fit: Fit) -> Iterator[str]:
            if left := [n.partition(".")[2] for n in start if n not in determined(fit)]:
                yield f"The logs do not tell {', '.join(left)}: as in the file."

        return Procedure(
            name="masses",
            title="Masses of the links: torque over that of a kilogram",
            figure=0,
            signals={n: arm.signals[n] for n in arm.angles},
            law="The momentum balance of the cylinders",
            samples=parts,
            start=lambda _: start | dry | offsets | ripple,
            tested=[*offsets, *ripple],
            refined=rippled,
            priors={n: PRIOR * x for n, x in start.items()},
            limits=lambda tests: data.zero_limits(
                tests, [n for n in readings if all(n in r.signals for r in tests)]
            ),
            estimates=estimates,
            others=lambda fit: [Estimate.normal(n, fit[n], "N", fit.sd(n), "momentum balance") for n in dry],
            panels=panels,
            remarks=remarks,
            check=fitting,
        )


def identify(crane: Crane, logs: Path) -> tuple[list[ProcedureResult], list[str]]:
    """Results, and a sentence on each procedure that has none; a Problem if all have none."""
    found, missing = _identified(crane, crane.read(logs), logs)
    return found, [_text(*x) for x in missing.items()]


def _identified(
    crane: Crane, tests: Recordings, logs: Path
) -> tuple[list[ProcedureResult], dict[str, Problem]]:
    """Results, and why procedures have none; before the first fit a Problem if nothing moves."""
    found, missing = list[ProcedureResult](), dict[str, Problem]()
    places = [n for f in crane.functions for n in [*f.signals][:1]]
    if not any(moved(r, n) for r in tests for n in places if n in r.signals):
        still = first_names(n.rpartition(".")[2] for n in places)
        raise Problem(_too_little(crane, tests, logs, f"nothing moves, {still} are constant but for noise"))
    for declared in (*(f.procedure for f in crane.functions), crane.masses):
        try:
            used = [r for r in tests if declared.signals.keys() <= r.signals.keys()]
            if not used:
                lacking = (n for n in declared.signals if not all(n in r.signals for r in tests))
                raise NotAsked(f"no reading of {', '.join(lacking)}")
            *readings, command = declared.signals
            rests = [n for n in readings if not any(moved(r, n) for r in used)]
            if rests and declared.name != "masses":
                kind = Problem if any(moved(r, command) for r in used) else NotAsked
                raise kind(f"{', '.join(rests)} at rest")
            found.append(solve(declared, used, crane.known))
        except Problem as error:
            missing[declared.name] = error
    if not found:
        raise Problem(f"{logs}: nothing was identified: {'; '.join(_text(*x) for x in missing.items())}")
    return found, missing


def _text(procedure: str, reason: Problem) -> str:
    text = f"{procedure}: {str(reason).removeprefix(f'{procedure}: ')}"
    return text + UNLIKE * ("converge" in text)


def _too_little(crane: Crane, tests: Recordings, logs: Path, got: str) -> str:
    """What was found in logs, whether they are too short, and what to record."""
    wanted, seconds = REST + EACH * len(crane.functions), sum(float(np.ptp(r.time)) for r in tests)
    length = f"{seconds:.3g} s{', too short' if seconds < wanted else ''}"
    return f"{logs}: {length}: {got}; record {wanted:g} s or more: {RECORD}, and {REST:g} s of rest"


def keys(crane: Crane, results: Sequence[ProcedureResult]) -> dict[str, Number]:
    """The estimates as parameters of the crane's FMUs."""
    estimates = {e.name: e for r in results for e in r.estimates}
    of_arm = {n: e for n, e in estimates.items() if n in crane.known and e.value > 0}
    found = {n.partition(".")[2]: e.number() for n, e in of_arm.items()}
    for f in crane.functions:
        found |= {f"{f.joint}_{n}": x for n, x in _keys_of_valve(f, estimates).items()}
    return found


def _keys_of_valve(f: Function, estimates: Mapping[str, Estimate]) -> dict[str, Number]:
    """Area of the widest edge, dead band out, and curves of the edges that differ; leakage of a motor.

    Values that the logs do not tell are those of the file; a curve that it has of the widest edge gets zeros.
    Leakage past seals is a parameter of a machine with faults only, so it is left out.
    """
    own = {n.removeprefix(f"{f.joint} "): estimates.get(n) for n in f.start}
    value = {n: e.value if e else f.start[f"{f.joint} {n}"][0] for n, e in own.items()}
    areas, found = {short: value[n] for n, short in EDGES.items()}, dict[str, Number]()
    widest = next(n for n in EDGES if areas[EDGES[n]] == max(areas.values()))
    if any(own[n] for n in (*EDGES, OUT, IN)):
        bands = {short: value[OUT if n in ("P-A", "B-T") else IN] for n, short in EDGES.items()}
        shape = f.known("valve_command_rounding"), f.known("valve_full_command")
        curves = edge_curves(areas, bands, value[OUT], *shape)
        of_file = [n for e in areas if f.known(f"valve_{e}_command_2") for n in f.points(e)]
        curves |= {n: (0.0, "V" if "command" in n else "1") for n in of_file if n not in curves}
        curves |= {"valve_area": (value[widest], "m2"), "valve_dead_band": (value[OUT], "V")}
        found |= {n: Number(x, unit, "identified", NOTE) for n, (x, unit) in curves.items()}
    for key, e in (("valve_area", own[widest]), ("valve_dead_band", own[OUT])):
        found |= {key: e.number()} if e else {}
    for n, name in f.others.items():
        if (e := own[n]) and e.value > 0 and name.endswith("resistance"):
            note = e.number().note
            found[name] = Number(1 / e.value, "Pa.s/m3", "identified", note, e.sd / e.value**2)
        elif e and e.value > 0 and n == "capacitance":
            found[name] = e.number()
    return found


def run(description: CraneDescription, logs: Path, out: Path) -> Report:
    """Identify a crane, and write the parameters of its FMUs to a file (.toml)."""
    if out.suffix != ".toml":
        raise Problem(f"--out {out}: expected a file that ends in .toml")
    if out.is_file() and "parameters" not in toml.read_file(out).data:
        raise Problem(f"--out {out}: expected no file or one of parameters, got another")
    crane = Crane(description)
    tests = crane.read(logs)
    results, missing = _identified(crane, tests, logs)
    parameters = keys(crane, results)
    write(out, {"parameters": parameters})
    wrong = [f"warning: {x.sentence}" for x in named(x for r in results for x in r.findings)]
    why = [_text(*x) for x in missing.items()]
    left = [
        *(f"not identified: {text}" for text in why),
        *(f"{r.procedure}: {x}" for r in results for x in r.remarks),
    ]
    sections = list[Section]()
    for r in results:
        pictures = Columns([Figure(x, r.title) for x in procedure_figures(r)])
        content: list[Part] = [pictures, Text(r.remarks), _table(r.others)]
        sections.append(Section(r.title, content, folded=True, only=PAGE))
    told = _table([e for r in results for e in r.estimates])
    data = [{n: x for n, x in vars(r).items() if n != "panels"} for r in results]
    use = f"harvester build --crane {description.file} --parameters {out} takes them"
    against = any(isinstance(x, Contradicted) for x in missing.values())
    if wrong or against:
        use = f"doubtful by the {'warnings' if wrong else 'law that does not hold'}; {use}"
    verdict = f"{out}: {len(parameters)} parameters; {use}"
    known, untold = {e.name for r in results for e in r.estimates}, (Contradicted, NotAsked)
    lost = any(not isinstance(x, untold) for x in missing.values())
    asked = [f for f in crane.functions if not isinstance(missing.get(f.procedure.name), untold)]
    every = [n in known for f in asked for n in f.start]
    if little := sum(every) < ENOUGH * len(every):
        got = f"{sum(every)} of {len(every)} quantities of functions are told"
        verdict = f"{_too_little(crane, tests, logs, got)}. {verdict}"
    return Report(
        f"Identification: {description.title}",
        verdict,
        [told, Text(left, only=TERMINAL), Text(wrong, "warn"), *sections],
        {"results": data, "missing": why, "doubtful": little or lost},
        not (wrong or little or lost or against),
    )


def _table(estimates: Sequence[Estimate]) -> Table:
    rows = [[e.name.removeprefix("manipulator."), *e.displayed(e.digits)] for e in estimates]
    return Table(TextTable(("estimate", "value", "low", "high", "unit"), rows, left=(0, 4)))
