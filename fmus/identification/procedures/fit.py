"""A law fitted to the recordings of an experiment, and what every procedure says of it.

A `Fit` has the tests of what all procedures take for granted, sentences on the estimates, and panels of data
that are linear in an unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from fmus.identification import balance
from fmus.identification.balance import SMALLEST, UNLIKELY, Samples, Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.recordings.masks import KNOWN
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    coverage_factor,
)
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

LAGS, CORRELATED = 5, 0.2  # windows, and correlation of whitened residuals that is no contradiction
UNTOLD = 5.0  # limits of a zero above which its standard deviation allows no test
ONE_WAY = 0.9  # rank correlation of an effect with time from which on its change in time cannot be told
SHIFT = 0.5  # sample times by which two sensors may be apart
METERS = {"pressure": ("pressure sensor", BAR), "flow": ("flow meter", LITRES_PER_MINUTE)}  # by names
Course = tuple[Array, str]  # time or oil temperature of each sample, and the word for it


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
    """A law fitted to the recordings of an experiment.

    label        of findings: the procedure and what it estimates
    recordings   without the delays of loggers
    signals      that the law reads, whose noise is tested
    along        `Course` of the samples of each recording
    delays       tested delays -> signals that have them
    late         signals whose delay is estimated, if any
    taken        part of it that was taken out of the recordings [s]
    known        what the procedure takes as known
    """

    label: str
    recordings: Sequence[Recording]
    signals: Collection[str]
    solution: Solution
    along: Sequence[Course]
    delays: Mapping[str, Sequence[str]] = field(default_factory=dict)
    late: Sequence[str] = ()
    taken: float = 0.0
    known: Any = None

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

    def remarks(self, wanted: Iterable[Quantity | Estimate], law: str) -> Iterator[str]:
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
                f"{law} leaves residuals {fit.times_noise:.3g} times as large as the noise: the model is "
                "incomplete. The intervals are widened by that factor."
            )

    # ---- tests ---------------------------------------------------------------------------------------

    def findings(
        self,
        drift: Mapping[str, str],
        equal: Collection[str] = (),
        given: Sequence[Array] = (),
    ) -> Iterator[Finding]:
        """Tests of zeros, delays, a drift of some unknowns, the law, and the description of the signals.

        drift   unknown -> words for it
        equal   unknowns that are the same in all recordings
        given   whitened columns whose effects are free in the test of a drift
        """
        for name, words in drift.items():
            yield from self._drift(name, words, given)
        for name in equal if len(self.recordings) > 1 else ():
            yield self._equal(name)
        yield from self._zeros()
        if self.delays:
            yield self.shift()
        yield self.model()
        yield from data.signal_findings(self.recordings, self.signals, self.label)

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

    def widened(self, equal: Collection[str]) -> Fit:
        """With standard deviations that cover unknowns which differ between the recordings."""
        every = self.solution.every
        scale = np.ones(len(every.names))
        for name in equal if len(self.recordings) > 1 else ():
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
        tested = [n for n in self.solution.names if n not in (*self.solution.every.names, *self.delays)]
        given, found = [self.solution.column(n) for n in tested], list[tuple[float, float, float, str]]()
        least = tolerance / self.solution.samples[0].rate
        for name, late in self.delays.items():
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
        return Finding("time shift", min(1.0, len(self.delays) * p), sentence)

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

    def model(self) -> Finding:
        """Whether the residual is an effect that the law lacks: too large, or correlated beyond noise.

        A noise that is known to a factor of two (`KNOWN`) and neighbours with a correlation of
        `CORRELATED` are no contradiction; the interval covers them. Without noise nothing is tested.
        """
        fit, samples = self.solution.fit, self.solution.samples
        sentence = f"{self.label}: the residuals are {fit.times_noise:.3g} times the noise of the sensors"
        exact = any(np.any(s.sd[:, 0] <= SMALLEST * np.max(np.abs(s.raw), axis=1)) for s in samples)
        if exact or fit.freedom < 1:
            return Finding("model", 1.0, sentence)
        too_large = float(stats.ncx2.sf(fit.chi_square, fit.freedom, (KNOWN**2 - 1) * fit.freedom))
        correlated, largest = 1.0, 0.0
        if fit.freedom >= LAGS * 10 and samples[0].bump.size > 1:
            correlated, largest = self._correlation()
        if correlated < too_large:
            sentence += f", and neighbours in time have a correlation of {largest:.2g}"
        return Finding("model", min(1.0, 2 * too_large, 2 * correlated), sentence)

    def _correlation(self) -> tuple[float, float]:
        """Probability that no neighbours are correlated by more than `CORRELATED`; largest correlation."""
        fit, parts = self.solution.fit, zip(self.solution.samples, self.solution.parts, strict=True)
        rows = [part.e.reshape(-1, s.law.rows) for s, part in parts]
        total, least, largest = max(fit.chi_square, fit.freedom), 1.0, 0.0
        for lag in range(1, LAGS + 1):
            products = np.concatenate([(r[lag:] * r[:-lag]).ravel() for r in rows])
            rho = float(products.sum()) / total
            least = min(least, balance.probability(rho, products.size**-0.5, CORRELATED))
            largest = max(largest, abs(rho))
        return LAGS * least, largest

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
