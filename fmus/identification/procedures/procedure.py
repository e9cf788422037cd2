"""A procedure as a declaration: its law, what is estimated, tested and told; `solve` carries it out.

A declaration names the signals of an experiment and their law, and `solve` does what all procedures have in
common: it selects the recordings, fits the law with the zeros of the sensors and without the delay of a
logger, tests what was taken for granted, and fills a `ProcedureResult`. A `Fit` is the law fitted to the
recordings, with the tests of what all procedures take for granted, sentences on the estimates, and panels of
data that are linear in an unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from scipy import stats
from scipy.ndimage import shift

from fmus.identification import balance
from fmus.identification.balance import SMALLEST, UNLIKELY, Law, Samples, Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.masks import KNOWN, good, good_all
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
    coverage_factor,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

LAGS, CORRELATED = 5, 0.2  # windows, and correlation of whitened residuals that is no contradiction
UNTOLD = 5.0  # limits of a zero above which its standard deviation allows no test
ONE_WAY = 0.9  # rank correlation of an effect with time from which on its change in time cannot be told
SHIFT = 0.5  # sample times by which two sensors may be apart
METERS = {"pressure": ("pressure sensor", BAR), "flow": ("flow meter", LITRES_PER_MINUTE)}  # by names
Course = tuple[Array, str]  # time or oil temperature of each sample, and the word for it
ROUNDS = 4  # of fits with a delay, each without that which the one before has found
Recordings: TypeAlias = Sequence[Recording]
Parameters: TypeAlias = Mapping[str, Number]
Parts: TypeAlias = Sequence[tuple[Samples, Course]]  # samples of the law, each with its course
# (signals, unknowns, constants) -> residual of each equation, and what is stored if the law is not steady
Equations: TypeAlias = Callable[..., Any]


class Contradicted(Problem):
    """The data contradict a law."""


class NotAsked(Problem):
    """The recordings have no signals or no motion for a procedure."""


@dataclass(frozen=True)
class Quantity:
    """A parameter of the machine, or of the tested part: an unknown times a factor, or the factor over it."""

    name: str
    unit: str
    unknown: str
    note: str
    factor: float = 1.0
    inverse: bool = False


@dataclass(frozen=True)
class Tested:
    """An unknown whose effect is tested: words for it, and the size of the effect per unit of it."""

    words: str
    size: Callable[..., float]  # of the signals of all samples


def delay_of(late: Sequence[str]) -> str:
    """Name of the delay of some signals as an unknown."""
    return f"delay of {', '.join(late)}"


@dataclass(frozen=True)
class Fit:
    """The law of a procedure, fitted to the recordings of an experiment.

    recordings   without the delays of loggers
    along        `Course` of the samples of each recording
    late         signals whose delay is estimated, if any
    taken        part of it that was taken out of the recordings [s]
    known        what the procedure takes as known
    """

    procedure: Procedure
    recordings: Sequence[Recording]
    solution: Solution
    along: Sequence[Course]
    late: Sequence[str] = ()
    taken: float = 0.0
    known: Any = None

    @property
    def label(self) -> str:
        """Of findings: what the procedure estimates."""
        return self.procedure.label or self.procedure.name

    def __getitem__(self, unknown: str) -> float:
        return self.solution.fit[unknown]

    def sd(self, unknown: str) -> float:
        """Standard deviation of an unknown."""
        return self.solution.fit.sd(unknown)

    @property
    def _both(self) -> Iterator[tuple[Samples, balance.Linear]]:
        parts = zip(self.solution.samples, self.solution.parts, strict=True)
        return ((s, part.linear) for s, part in parts)

    def column(self, unknown: str, row: int = 0) -> Array:
        """-de/d(unknown) of one equation at all samples or windows, shape (N,)."""
        return -1.0 * np.concatenate([one.by_theta[s.names.index(unknown), row] for s, one in self._both])

    def residual(self, row: int = 0) -> Array:
        """e of one equation, shape (N,)."""
        return np.concatenate([one.e[row] for _, one in self._both])

    def error(self, row: int = 0) -> Array:
        """Standard deviation of e by the noise of steady samples, shape (N,)."""
        squares = [(one.g[:, row, :, 0] * s.sd) ** 2 for s, one in self._both]
        return np.asarray(np.sqrt(np.concatenate([x.sum(axis=0) for x in squares])))

    def expect_positive(self, values: Iterable[tuple[str, float, float]], hint: str) -> None:
        """Raise Problem if a value (name, value, standard deviation) is significantly negative."""
        for name, value, sd in values:
            if value < -balance.SIGNIFICANT * sd:
                files = ", ".join(str(r.source) for r in self.recordings)
                raise Problem(f"{files}: {name}: expected positive, got {value:.3g}: {hint}")

    # ---- estimates and sentences ---------------------------------------------------------------------

    def estimates(self, wanted: Iterable[Quantity | Estimate]) -> tuple[Estimate, ...]:
        """Those whose unknown the data determine."""
        every = ((q, q if isinstance(q, Estimate) else self.estimate(q)) for q in wanted)
        fit = self.solution.fit
        return tuple(e for q, e in every if isinstance(q, Estimate) or fit.determined(q.unknown))

    def estimate(self, q: Quantity) -> Estimate:
        """One quantity with its interval."""
        if q.inverse:
            return self.derived(q.name, q.unit, q.note, q.unknown, lambda x: q.factor / x)
        value, sd = q.factor * self[q.unknown], abs(q.factor) * self.sd(q.unknown)
        return Estimate.normal(q.name, value, q.unit, sd, q.note)

    def derived(
        self, name: str, unit: str, note: str, unknown: str, function: Callable[[float], float]
    ) -> Estimate:
        """A function of one unknown, with its standard deviation by a difference over its noise.

        The interval of a positive value is that of its logarithm, so that it stays positive.
        """
        value, step = self[unknown], self.sd(unknown) / 10
        sd = 5 * abs(function(value + step) - function(value - step))
        return Estimate.normal(name, function(value), unit, sd, note, log=True)

    def remarks(self, wanted: Iterable[Quantity | Estimate]) -> Iterator[str]:
        """What was used, which unknowns stay open, whether the law fits."""
        fit, samples = self.solution.fit, self.solution.samples
        count = sum(s.starts.size for s in samples)
        of = f"of {len(self.recordings)} recording{'s' * (len(self.recordings) > 1)}"
        if all(s.steady for s in samples):
            yield f"{count} steady stretches {of} are used."
        else:
            every = [np.ones(s.raw.shape[1] - s.taps + 1, dtype=bool) for s in samples]
            possible = sum(
                balance.window_starts(x, s.bump.size).size for x, s in zip(every, samples, strict=True)
            )
            left = f"{100 * (1 - count / possible):.2g} % is" if count < possible else "nothing is"
            yield f"{count} windows {of} are used, {left} left out because of bad samples nearby."
        quantities = [q for q in wanted if isinstance(q, Quantity)]
        for q in {q.unknown: q for q in quantities if not fit.determined(q.unknown)}.values():
            unit = "" if q.inverse else f" {q.unit}"
            yield (
                f"The data do not determine {q.unknown}: {fit[q.unknown]:.2g} +- {fit.sd(q.unknown):.1g}"
                f"{unit}. {q.name} keeps its known value."
            )
        if fit.misfit:
            yield (
                f"{self.procedure.law} leaves residuals {fit.times_noise:.3g} times as large as the noise: "
                "the model is incomplete. The intervals are widened by that factor."
            )

    # ---- tests ---------------------------------------------------------------------------------------

    def findings(self) -> Iterator[Finding]:
        """Tests of zeros, delays, a drift of some unknowns, the law, and the description of the signals."""
        declared = self.procedure
        for name, words in declared.drift.items():
            yield from self._drift(name, words, declared.given(self))
        for name in declared.equal if len(self.recordings) > 1 else ():
            yield self._equal(name)
        yield from self._zeros()
        if declared.loggers:
            yield self.shift()
        yield misfit(self.label, self.solution)
        yield from data.signal_findings(self.recordings, declared.signals, self.label)

    def effects(self, tested: Mapping[str, Tested], unit: tuple[str, float]) -> Iterator[Finding]:
        """Whether some tested unknowns, fitted together, have an effect; in a display unit."""
        values, covariance = self.solution.effects(np.array([self.solution.column(n) for n in tested]))
        for one, value, sd in zip(tested.values(), values, np.sqrt(np.diag(covariance)), strict=True):
            size = one.size(*self.solution.samples[0].raw) / unit[1]
            sentence = f"{self.label}: {one.words} of {value * size:.2g} +- {sd * size:.1g} {unit[0]}"
            yield Finding("model", balance.probability(value, sd), sentence)

    def _differences(self, name: str) -> tuple[Array, float]:
        """An unknown in the other recordings less that in the first one; probability of one for all."""
        column, ends = self.solution.column(name), [part.e.size for part in self.solution.parts]
        of = np.repeat(np.arange(len(ends)), ends)
        own = np.array([column * (of == k) for k in range(1, len(ends))])
        values, covariance = self.solution.effects(own)
        chi_square = float(values @ np.linalg.solve(covariance, values))
        return values, float(stats.chi2.sf(chi_square, values.size))

    def _equal(self, name: str) -> Finding:
        """Whether one value of an unknown describes all recordings."""
        values, p = self._differences(name)
        percent = ", ".join(f"{100 * x / self[name]:+.2g} %" for x in values)
        told = f"{name} differs between the recordings: {percent} from the first to the others"
        return Finding("model", p, f"{self.label}: {told}")

    def widened(self) -> Fit:
        """With standard deviations that cover unknowns which differ between the recordings."""
        every = self.solution.every
        scale = np.ones(len(every.names))
        for name in self.procedure.equal if len(self.recordings) > 1 else ():
            values, p = self._differences(name)
            if p < UNLIKELY:
                of_mean = np.append(0.0, values).std(ddof=1) / math.sqrt(len(self.recordings))
                scale[every.names.index(name)] = max(1.0, of_mean / self.sd(name))
        every = replace(every, covariance=every.covariance * np.outer(scale, scale))
        return replace(self, solution=replace(self.solution, every=every))

    def _zeros(self) -> Iterator[Finding]:
        """For each pressure sensor and flow meter: whether the data want its zero outside its declaration."""
        for name, limit in self.solution.limits.items():
            kind = next((word for word in METERS if word in name), None)
            change, sd = self.solution.free(name) if kind else (0.0, math.inf)
            value = self.solution.every[name] + change
            if kind and sd < UNTOLD * limit:  # else the data tell nothing about this zero
                word, (unit, one) = METERS[kind]
                yield Finding(
                    f"zero of a {word}",
                    balance.probability(value, sd, limit),
                    f"{self.label}: the data fit best with a zero of {name} of {value / one:.3g} +- "
                    f"{sd / one:.2g} {unit}; the declared limit is {limit / one:.3g} {unit}",
                )

    def shift(self, tolerance: float = SHIFT) -> Finding:
        """Whether some signals are late against the others, by more than `tolerance` samples.

        Unknowns that are not fitted are free in this test.
        """
        delays = {delay_of(late): late for late in self.procedure.loggers}
        tested = [n for n in self.solution.names if n not in (*self.solution.every.names, *delays)]
        given, found = [self.solution.column(n) for n in tested], list[tuple[float, float, float, str]]()
        least = tolerance / self.solution.samples[0].rate
        for name, late in delays.items():
            if self.late:
                value, sd = self.taken + self[delay_of(self.late)], self.sd(delay_of(self.late))
            else:
                value, sd = self.solution.effect(self.solution.column(name), given)
            if not self.late or late == self.late:
                found.append((balance.probability(value, sd, least), value, sd, ", ".join(late)))
        p, value, sd, sensors = min(found)
        sentence = f"{self.label}: {sensors} would have to be {1e3 * value:.3g} +- {1e3 * sd:.2g} ms late"
        if self.late:
            sentence += f"; the estimates are without this delay, the key `delay = {value:.2g}` corrects it"
        return Finding("time shift", min(1.0, len(delays) * p), sentence)

    def over(self, name: str, along: Array) -> Array:
        """The column of an unknown that changes in proportion to something over its range, shape (N,)."""
        rows = self.solution.samples[0].law.rows
        along = np.repeat((along - along.mean()) / (float(np.ptp(along)) or 1.0), rows)
        return np.asarray(self.solution.column(name) * along)

    def _drift(self, name: str, words: str, given: Sequence[Array]) -> Iterator[Finding]:
        """Whether an unknown changes in time or with the temperature of the oil.

        A change of less than its standard deviation is no contradiction. Where its effect only grows or only
        falls with the time, nothing is told.
        """
        along, word = np.concatenate([values for values, _ in self.along]), self.along[0][1]
        size = np.abs(self.column(name))
        if np.ptp(size) and np.ptp(along) and abs(float(stats.spearmanr(size, along)[0])) >= ONE_WAY:
            return
        change, sd = self.solution.effect(self.over(name, along), given)
        percent = 100 / abs(self[name])
        yield Finding(
            "oil temperature",
            balance.probability(change, sd, self.sd(name)),
            f"{self.label}: {words} changes with the {word} by {percent * change:+.3g} +- "
            f"{percent * sd:.2g} % over all of it",
        )

    # ---- panels --------------------------------------------------------------------------------------

    def line(self, panel: Panel, unknown: str, row: int = 0, per: Array | float = 1.0) -> tuple[Panel, Panel]:
        """Data over the effect of an unknown, whose slope it is, and the residual; both `per` something.

        Error bars are drawn at the residuals only: next to the line they would be too short to see.
        """
        x, slope = self.column(unknown, row) / per, self[unknown]
        y, ends = slope * x + self.residual(row) / per, np.array([min(x.min(), 0.0), max(x.max(), 0.0)])
        steady = all(s.steady for s in self.solution.samples)
        measured = Curve("measured" if steady else "measured, filtered", x, y)
        error = coverage_factor() * self.error(row) if steady else None
        curves = measured, Curve("fit", ends, slope * ends, "fit", line=True)
        left = replace(measured, y=y - slope * x, error=error)
        return replace(panel, curves=curves), replace(panel, y_label="residual", title="", curves=(left,))

    def over_time(self, panel: Panel, unknown: str, k: int, known: float = 0.0) -> Iterator[Panel]:
        """One recording over time: the effect of an unknown above a known value, and the residual."""
        s, part = self.solution.samples[k], self.solution.parts[k].linear
        effect = -part.by_theta[s.names.index(unknown), 0] * (self[unknown] - known)
        time = self.recordings[k].time[0] + s.times
        curves = Curve("measured, filtered", time, effect + part.e[0]), Curve("fit", time, effect, "fit")
        yield replace(panel, curves=curves)
        left = Curve("measured - fit", time, part.e[0])
        yield replace(panel, y_label="residual", title="", y_unit=("N.m", 1.0), curves=(left,))


def misfit(label: str, solution: Solution) -> Finding:
    """Whether the residual is an effect that the law lacks: too large, or correlated beyond noise.

    A noise that is known to a factor of two (`KNOWN`) and neighbours with a correlation of
    `CORRELATED` are no contradiction; the interval covers them. Without noise nothing is tested.
    """
    fit, samples = solution.fit, solution.samples
    sentence = f"{label}: the residuals are {fit.times_noise:.3g} times the noise of the sensors"
    exact = any(np.any(s.sd[:, 0] <= SMALLEST * np.max(np.abs(s.raw), axis=1)) for s in samples)
    if exact or fit.freedom < 1:
        return Finding("model", 1.0, sentence)
    too_large = float(stats.ncx2.sf(fit.chi_square, fit.freedom, (KNOWN**2 - 1) * fit.freedom))
    correlated, largest = 1.0, 0.0
    if fit.freedom >= LAGS * 10 and samples[0].bump.size > 1:
        correlated, largest = _correlation(solution)
    if correlated < too_large:
        sentence += f", and neighbours in time have a correlation of {largest:.2g}"
    return Finding("model", min(1.0, 2 * too_large, 2 * correlated), sentence)


def _correlation(solution: Solution) -> tuple[float, float]:
    """Probability that no neighbours are correlated by more than `CORRELATED`; largest correlation."""
    fit, parts = solution.fit, zip(solution.samples, solution.parts, strict=True)
    rows = [part.e.reshape(-1, s.law.rows) for s, part in parts]
    total, least, largest = max(fit.chi_square, fit.freedom), 1.0, 0.0
    for lag in range(1, LAGS + 1):
        products = np.concatenate([(r[lag:] * r[:-lag]).ravel() for r in rows])
        rho = float(products.sum()) / total
        least = min(least, balance.probability(rho, products.size**-0.5, CORRELATED))
        largest = max(largest, abs(rho))
    return LAGS * least, largest


# ---- declarations -------------------------------------------------------------------------------------


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
    refined    (fit, the fit of another declaration) -> the fit that is used
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
    refined: Callable[[Fit, Callable[[Procedure], Fit]], Fit] = lambda fit, _: fit
    check: Callable[[Fit], object] = _nothing
    label: str = ""

    def identify(self, recordings: Recordings, parameters: Parameters) -> ProcedureResult:
        """`solve` with the training recordings of this procedure."""
        return solve(self, data.training_recordings(recordings, self.name, self.signals), parameters)


def solve(d: Procedure, tests: Recordings, parameters: Parameters) -> ProcedureResult:
    """Estimates, panels, remarks and findings of a declaration from its recordings."""
    fit = fit_of(d, tests, parameters)
    told = fit.widened()
    wanted = [*d.estimates(told)]
    return ProcedureResult(
        procedure=d.name,
        title=d.title.format(fit.known),
        figure=d.figure,
        estimates=told.estimates(wanted),
        panels=tuple(d.panels(fit)),
        remarks=(*told.remarks(wanted), *d.remarks(fit)),
        others=tuple(d.others(told)),
        findings=(*d.findings(fit), *fit.findings()),
    )


def fit_of(d: Procedure, tests: Recordings, parameters: Parameters) -> Fit:
    """The fit that is used."""
    known = d.known(tests, parameters)
    fit = d.refined(fitted(d, tests, known), lambda other: fitted(other, tests, known))
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
            fit = Fit(d, moved, solution, along, late, taken, known)
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
