"""Settings of a convergence study, and their runs at every communication step, with error and wall time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from math import log
from statistics import median
from typing import Any, Unpack

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.options import seconds
from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.run import attempt, run
from orchestrator.engine.scenario import ScenarioSource
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.masters import MASTERS
from orchestrator.ssp.swap import used_ports
from orchestrator.ssp.system import System
from orchestrator.studies.convergence.reference_solution import ReferenceSolution, SignalDeviation

UNSTABLE_ERROR = 1.0  # relative to the range of a signal: a run with a larger error is unstable
ROUNDING = 1e-12  # NRMSE below which rounding errors hide the order of convergence


# ---- the ways of coupling that are compared


@dataclass(frozen=True)
class Setting:
    """One way of coupling.

    without_rates  without the connections of rate ports: what a textbook master would get
    cases          for masters with adaptive step size: couplings by name, such as one per tolerance; they are
                   compared instead of steps
    """

    label: str
    coupling: Coupling
    without_rates: bool = False
    cases: Mapping[str, Coupling] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """The settings that are drawn in one colour."""
        return "plain" if self.without_rates else "adaptive" if self.cases else self.coupling.method.name

    def matches(self, pattern: str) -> bool:
        """Is the pattern the name of the master, or does the label match it?"""
        return pattern == self.coupling.method.name or fnmatchcase(self.label, pattern)


TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
EXTRAPOLATING = tuple(master.name for master in MASTERS.values() if not master.guarded)
SETTINGS = (
    *(Setting(f"{master} plain", Coupling(master, 0), without_rates=True) for master in EXTRAPOLATING),
    *(Setting(f"{m} order {order}", Coupling(m, order)) for m in EXTRAPOLATING for order in range(3)),
    Setting("hermite 1 pass", Coupling("hermite", passes=1, guard=0)),  # the same as gauss-seidel of order 3
    Setting("hermite 2 passes", Coupling("hermite", passes=2, guard=0)),
    Setting("hermite to tolerance", Coupling("hermite", guard=0)),
    Setting("hermite", Coupling("hermite")),
    Setting("interface-jacobian unguarded", Coupling("interface-jacobian", guard=0)),
    Setting("interface-jacobian", Coupling("interface-jacobian")),
    Setting(
        "hermite adaptive",
        Coupling("hermite"),
        cases={f"{tolerance:.0e}": Coupling("hermite", adaptive=tolerance) for tolerance in TOLERANCES},
    ),
)


def choose(patterns: Iterable[str]) -> tuple[Setting, ...]:
    """The settings that match: names of masters, labels or patterns of labels; all without patterns."""
    requested = tuple(patterns)
    for pattern in requested:
        if not any(setting.matches(pattern) for setting in SETTINGS):
            names = [*MASTERS, *(setting.label for setting in SETTINGS)]
            near = suggest(pattern, names) or f"; there are {', '.join(names)}"
            raise Problem(f"masters {pattern}: no setting of that name{near}")
    return tuple(s for s in SETTINGS if not requested or any(s.matches(pattern) for pattern in requested))


def rate_inputs(system: System) -> tuple[str, ...]:
    """The connected inputs that are derivatives of others: they carry no power, and are optional."""
    return tuple(
        f"{component.name}.{name}"
        for component in system.components.values()
        for name, port in used_ports(system, component).items()
        if port.optional and port.connections and port.declared.causality == "input"
    )


# ---- their runs


@dataclass(frozen=True)
class SettingRun:
    """The run of one setting at one step. Times in [s].

    step     communication step; of an adaptive run the first one to try
    case     of an adaptive run: its name in `Setting.cases`
    errors   group -> errors of its signals, the largest first; empty if the run ended early or was refused
    steps    number of communication steps
    walls    wall times, one for each repetition of the run
    failure  why the run ended early; empty if it did not
    refusal  why there was no run: what the FMUs lack for this master
    """

    setting: Setting
    step: float
    case: str = ""
    errors: Mapping[str, tuple[SignalDeviation, ...]] = field(default_factory=dict)
    steps: int = 0
    simulated: float = 0.0
    walls: tuple[float, ...] = ()
    failure: str = ""
    refusal: str = ""

    @property
    def mean_step(self) -> float:
        """Simulated time over number of steps [s]; `step` if there was none."""
        return self.simulated / self.steps if self.steps else self.step

    @property
    def wall(self) -> float:
        """Median over the repetitions [s]."""
        return median(self.walls) if self.walls else float("nan")

    @property
    def cost(self) -> float:
        """Wall time over simulated time."""
        return self.wall / self.simulated if self.simulated else float("nan")

    @property
    def stable(self) -> bool:
        """The run came to the end, and no error was ever larger than the range of its signal."""
        errors = [e for group in self.errors.values() for e in group]
        return bool(errors) and all(e.maximum < UNSTABLE_ERROR * e.span for e in errors)

    def error(self, group: str) -> float:
        """NRMSE of the worst signal of a group."""
        return self.errors[group][0].nrmse

    def maximum(self, group: str) -> SignalDeviation:
        """The signal of a group with the largest difference."""
        return max(self.errors[group], key=lambda e: e.maximum)


@dataclass(frozen=True)
class ConvergenceStudy:
    """All runs of a study, by setting with increasing steps."""

    reference: ReferenceSolution
    runs: tuple[SettingRun, ...]
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> list[float]:
        """The communication steps of the study [s], the smallest first."""
        return sorted({r.step for r in self.runs if not r.case})

    @property
    def settings(self) -> list[Setting]:
        """All settings, in their order."""
        return list({r.setting.label: r.setting for r in self.runs}.values())

    def of(self, setting: Setting) -> list[SettingRun]:
        """The runs of a setting, the smallest step first."""
        runs = (r for r in self.runs if r.setting.label == setting.label)
        return sorted(runs, key=lambda r: r.mean_step if r.case else r.step)

    def order(self, setting_run: SettingRun, group: str) -> float | None:
        """Observed order of convergence against the next smaller step; None unless both runs are stable."""
        finer = [r for r in self.of(setting_run.setting) if r.step < setting_run.step]
        if not finer or not finer[-1].stable or not setting_run.stable:
            return None
        small, large = finer[-1].error(group), setting_run.error(group)
        if min(small, large) < ROUNDING:
            return None
        return log(large / small) / log(setting_run.mean_step / finer[-1].mean_step)


def run_settings(
    system: System,
    reference: ReferenceSolution,
    settings: Sequence[Setting],
    steps: Sequence[float],
    repeats: int = 3,
    rates: Sequence[str] | None = None,
    scenario: ScenarioSource = None,
    **options: Unpack[RunArguments],
) -> Iterator[SettingRun]:
    """Run every setting at every step.

    repeats  how often a stable run is repeated; its wall time is the median
    rates    inputs whose connections a plain setting leaves out; default: those of rate ports
    options  of `run`, such as start, stop
    """
    reference.check(system)
    rates = rate_inputs(system) if rates is None else tuple(rates)
    start, stop = seconds(options.get("start"), "start"), seconds(options.get("stop"), "stop")
    start, sorted_steps = (system.start or 0.0) if start is None else start, sorted(steps)
    record_steps = {h: reference.record_step(start, stop, h) for h in sorted_steps}
    ports = [str(system.outputs[n].source) if n in system.outputs else n for n in reference.names]
    what = {"scenario": scenario, "record": list(dict.fromkeys(ports)), **options}
    any_run = False
    for setting in (s for s in settings if rates or not s.without_rates):
        coupled = system.without(*rates) if setting.without_rates else system
        adaptive = [SettingRun(setting, sorted_steps[0], case) for case in setting.cases]
        for plan in adaptive or [SettingRun(setting, step) for step in sorted_steps]:
            coupling = setting.cases.get(plan.case, setting.coupling)
            record_step = reference.adaptive_record_step(start) if plan.case else record_steps[plan.step]
            how = {"master": coupling, "step": plan.step, "record_step": record_step}
            try:
                done = _run(plan, reference, coupled, repeats, how | what)
            except Problem as problem:
                if not any_run:  # then nothing runs at all: the user's mistake, not a limit of the FMUs
                    raise
                done = replace(plan, refusal=str(problem))
            any_run = True
            yield done


def _run(
    plan: SettingRun, reference: ReferenceSolution, system: System, repeats: int, options: Mapping[str, Any]
) -> SettingRun:
    """One run, repeated for its wall time if it was stable."""
    result, failure = attempt(system, **options)
    card = result.card
    errors = {} if failure else reference.errors(result.trace, plan.step)
    done = replace(plan, errors=errors, steps=card.steps, simulated=card.simulated, failure=failure)
    more = repeats - 1 if done.stable else 0
    return replace(done, walls=(card.wall, *(run(system, **options).card.wall for _ in range(more))))
