"""A procedure as a declaration: its law, what is estimated, tested and told; `solve` carries it out.

A declaration names the signals of an experiment and their law, and `solve` does what all procedures have in
common: it selects the recordings, fits the law with the zeros of the sensors and without the delay of a
logger, tests what was taken for granted, and fills a `ProcedureResult`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from scipy.ndimage import shift

from fmus.identification import balance
from fmus.identification.balance import UNLIKELY, Law, Samples
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.fit import SHIFT, Course, Fit, Quantity, delay_of
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.masks import good, good_all
from fmus.identification.results import Estimate, Finding, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

ROUNDS = 4  # of fits with a delay, each without that which the one before has found
Recordings: TypeAlias = Sequence[Recording]
Parameters: TypeAlias = Mapping[str, Number]
Parts: TypeAlias = Sequence[tuple[Samples, Course]]  # samples of the law, each with its course
# (signals, unknowns, constants) -> residual of each equation, and what is stored if the law is not steady
Equations: TypeAlias = Callable[..., Any]


@dataclass(frozen=True)
class Computed:
    """A procedure that is no fit of one law: a function of recordings and known parameters."""

    name: str
    signals: Mapping[str, str]
    identify: Callable[[Recordings, Parameters], ProcedureResult]


def _nothing(*_: Any) -> tuple[Any, ...]:
    return ()


@dataclass(frozen=True)
class Procedure:
    """A procedure that fits one law; functions get `known` or the `Fit`, which has it.

    name       as in recordings, and of the result
    title      of its figure, a format of `known`
    figure     in the paper, 0 if there is none
    signals    that it needs, with their SI units
    law        words for the law
    samples    (recordings, known) -> samples of the law
    known      (recordings, parameters) -> what is known of the experiment
    start      (known) -> unknowns, and where the search for them begins
    limits     recordings -> largest errors of zeros, by sensor
    tested     unknowns that keep their start, because only their effect is tested
    priors     unknown -> standard deviation about its start of zero
    loggers    signals that may have another logger than the others
    estimates  (fit) -> parameters of the machine, as an unknown or computed
    others     (fit) -> estimates that are no parameters
    panels     (fit) -> data with the fit
    remarks    (fit) -> sentences besides those of all procedures
    findings   (fit) -> tests besides those of all procedures
    drift      unknown -> words for it, of which a change over the experiment is tested
    given      (fit) -> whitened columns whose effects are free in that test
    equal      unknowns that are the same in all recordings
    refined    (fit, fit again with other arguments of `fitted`) -> the fit that is used
    check      (fit) -> raises Problem if the data make no sense
    label      of its findings, the name by default
    """

    name: str
    title: str
    figure: int
    signals: Mapping[str, str]
    law: str
    samples: Callable[[Recordings, Any], Parts]
    start: Callable[[Any], Mapping[str, float]]
    limits: Callable[[Recordings], Mapping[str, float]]
    known: Callable[[Recordings, Parameters], Any] = _nothing
    tested: Collection[str] = ()
    priors: Mapping[str, float] = field(default_factory=dict)
    loggers: Collection[Sequence[str]] = ()
    estimates: Callable[[Fit], Iterable[Quantity | Estimate]] = _nothing
    others: Callable[[Fit], Iterable[Estimate]] = _nothing
    panels: Callable[[Fit], Iterable[Panel]] = _nothing
    remarks: Callable[[Fit], Iterable[str]] = _nothing
    findings: Callable[[Fit], Iterable[Finding]] = _nothing
    drift: Mapping[str, str] = field(default_factory=dict)
    given: Callable[[Fit], Sequence[Array]] = _nothing
    equal: Collection[str] = ()
    refined: Callable[[Fit, Callable[..., Fit]], Fit] = lambda fit, _: fit
    check: Callable[[Fit], object] = _nothing
    label: str = ""

    def identify(self, recordings: Recordings, parameters: Parameters) -> ProcedureResult:
        """`solve` with the training recordings of this procedure."""
        return solve(self, data.training_recordings(recordings, self.name, self.signals), parameters)


def solve(d: Procedure, tests: Recordings, parameters: Parameters) -> ProcedureResult:
    """Estimates, panels, remarks and findings of a declaration from its recordings."""
    fit = fit_of(d, tests, parameters)
    told = fit.widened(d.equal)
    wanted = [*d.estimates(told)]
    return ProcedureResult(
        procedure=d.name,
        title=d.title.format(fit.known),
        figure=d.figure,
        estimates=told.estimates(wanted),
        panels=tuple(d.panels(fit)),
        remarks=(*told.remarks(wanted, d.law), *d.remarks(fit)),
        others=tuple(d.others(told)),
        findings=(*d.findings(fit), *fit.findings(d.drift, d.equal, d.given(fit))),
    )


def fit_of(d: Procedure, tests: Recordings, parameters: Parameters) -> Fit:
    """The fit that is used."""
    known = d.known(tests, parameters)

    def again(**changes: Any) -> Fit:
        return fitted(replace(d, **changes), tests, known)

    fit = d.refined(again(), again)
    d.check(fit)
    return fit


def fitted(d: Procedure, recordings: Recordings, known: Any) -> Fit:
    """The law fitted to all recordings, without the delay of a logger.

    A delay that the data show clearly is estimated with the law. One of more than half a sample is taken out
    of the recordings first, whose bad samples move with it.
    """
    label, start, limits = d.label or d.name, d.start(known), d.limits(recordings)
    delays = {delay_of(late): late for late in d.loggers}

    def solved(late: Sequence[str]) -> Fit:
        """With the delay of some signals, or without any."""
        taken, fixed = 0.0, [n for n in delays if n != delay_of(late)]
        for _ in range(ROUNDS):
            moved = [_earlier(r, late, taken) for r in recordings] if taken else recordings
            samples, along = zip(*d.samples(moved, known), strict=True)
            solution = balance.solve(samples, start, label, limits, (*d.tested, *fixed), d.priors, delays)
            fit = Fit(label, moved, tuple(d.signals), solution, along, delays, late, taken, known)
            if not late or abs(fit[delay_of(late)]) * samples[0].rate <= SHIFT:
                break
            taken += fit[delay_of(late)]
        return fit

    problems, found = list[Problem](), list[Fit]()
    for late in ((), *d.loggers):
        try:
            fit = solved(late)
        except Problem as problem:  # as of a search that does not converge
            problems.append(problem)
            continue
        if not late and (not delays or fit.shift(tolerance=0.0).p > UNLIKELY):
            return fit
        found.append(fit)
    if not found:
        raise problems[0]
    return min(found, key=lambda fit: fit.solution.cost)


def _earlier(r: Recording, late: Sequence[str], delay: float) -> Recording:
    """The recording with late signals moved by their delay [s]; samples that are not good become gaps."""
    signals, samples = dict(r.signals), -delay * uniform_rate(r)
    for n in late:
        usable = shift(good(r, n).astype(float), samples, order=1) > 1 - 1e-9
        signals[n] = np.where(usable, shift(r.interpolated(n), samples, mode="nearest"), np.nan)
    return replace(r, signals=signals)


# ---- laws of signals, and their samples ----------------------------------------------------------------


@lru_cache(maxsize=8)
def law_of(equations: Equations, signals: int, unknowns: tuple[str, ...], constants: int = 1) -> Law:
    """The law of a number of signals, with unknowns by name and a number of constants."""
    z, known = ca.SX.sym("z", signals), ca.SX.sym("known", constants)
    u = {name: ca.SX.sym(name) for name in unknowns}
    terms = equations(*ca.vertsplit(z), SimpleNamespace(**u), *ca.vertsplit(known))
    return balance.law(z, u, known, *(ca.vertcat(*x) for x in terms))


def window_samples(
    recording: Recording, signals: Collection[str], law: Law, half_width: float, known: Sequence[float]
) -> tuple[Samples, Course]:
    """Signals of a recording over windows of good samples, `half_width` [s] to each side."""
    rate = uniform_rate(recording)
    bump, slope = balance.modulating_function(max(round(half_width * rate), 3), rate)
    raw = np.array([recording.interpolated(n) for n in signals])
    noise = np.array([data.noise_sd(recording, n) for n in signals])
    starts = balance.window_starts(good_all(recording, signals), bump.size)
    samples = balance.samples_of(law, signals, raw, noise, known)
    return data.with_course(recording, replace(samples, rate=rate, bump=bump, slope=slope, starts=starts))
