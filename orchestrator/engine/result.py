"""The result of a run, also of one that ends early: trace, accuracy card, messages and metadata.

The accuracy card contains the speed of the run and estimates of its errors. The metadata, with the units of
the signals, are in trace.run.json next to trace.csv; `harvester compare` reads them from there.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, write_whole
from orchestrator.base.options import given
from orchestrator.base.signals import CONSTANT, CONSTANT_OF_NOMINAL, largest, rms
from orchestrator.base.text import TextTable, first_names, grouped
from orchestrator.data.table import SUFFIXES, Array
from orchestrator.data.trace import METADATA_SUFFIX, FigureArguments, Trace, read_trace
from orchestrator.data.trace_writer import RowLayout, read_origin, write_trace
from orchestrator.engine.options import RunOptions
from orchestrator.fmi.messages import Log, LogMessage
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.provenance import Provenance
from orchestrator.ssp.system import System

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Event:
    """An event of a run: its time [s], the components that asked for it, and the signals that changed at it.

    The signals are those that are not continuous and feed others.
    """

    time: float
    causes: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Result(Mapping[str, NDArray[np.float64]]):
    """The result of a run, and a mapping of the names of its signals to their values, as its trace.

    trace      all outputs, connected inputs and inputs of the system (or the selected signals) at each
               recorded point
    card       the accuracy card
    messages   messages that the FMUs logged
    coupling   all choices about the coupling
    complete   False if the run ended early; the trace then ends there. A run that an FMU asked to end is
               complete, and has a note about it
    provenance checksums of the FMUs, and values that differ from the shipped ones, with their origin
    errors     estimate of truth minus value, of each recorded output of an FMU that declares its states, at
               some communication points; None without an estimate during the run, or if rows went to a file
    """

    system: System
    trace: Trace
    card: Card
    messages: tuple[LogMessage, ...] = ()
    complete: bool = True
    coupling: Coupling = field(default_factory=Coupling)
    provenance: Provenance = field(default_factory=Provenance)
    errors: Trace | None = None

    def write(self, path: str | Path) -> Path:
        """Write the trace as .csv, .parquet or .mat, and the metadata of the run next to it."""
        file = write_trace(self.trace, path, metadata_text(self, ""))
        write_whole(metadata_file(file), metadata_text(self, Location(file).sha256))
        write_events(self.card, file)
        return file

    @property
    def events(self) -> tuple[Event, ...]:
        """The events of FMUs that the run has handled, by time."""
        return self.card.events

    @property
    def texts(self) -> tuple[tuple[float, str, str], ...]:
        """Time [s], signal and value of each change of a text; a Binary in hexadecimal digits."""
        return self.card.texts

    def noted(self, *notes: str, errors: tuple[SignalError, ...] | None = None) -> Result:
        """This result with further notes, and with other estimates of errors, on its card."""
        card = replace(self.card, notes=(*self.card.notes, *notes))
        if errors is not None:
            card = replace(card, errors=errors).doubted(*unreliable_errors(errors, self.system))
        return replace(self, card=card)

    @property
    def time(self) -> NDArray[np.float64]:
        """The times of the samples, shape (n,) [s]."""
        return self.trace.time

    @property
    def units(self) -> Mapping[str, str]:
        """Name -> unit of each recorded signal."""
        return self.trace.units

    @overload
    def __getitem__(self, key: str) -> NDArray[np.float64]: ...
    @overload
    def __getitem__(self, key: list[str] | tuple[str, ...]) -> Trace: ...
    def __getitem__(self, key: str | list[str] | tuple[str, ...]) -> NDArray[np.float64] | Trace:
        """As `Trace`: the values of a signal, in its unit, or the trace with the signals of a list."""
        return self.trace[key]

    def _ipython_key_completions_(self) -> list[str]:
        return self.trace._ipython_key_completions_()

    def __iter__(self) -> Iterator[str]:
        return iter(self.trace)

    def __len__(self) -> int:
        return len(self.trace)

    @property
    def reliable(self) -> bool:
        """False if an error of the coupling is so large that the result must not be used."""
        return not self.card.unreliable

    @property
    def notes(self) -> tuple[str, ...]:
        """The warnings and notes of the card."""
        return (*self.card.warnings, *self.card.notes)

    def __repr__(self) -> str:
        end = "" if self.complete else ", ended early"
        end += "" if self.reliable else ", not reliable"
        counts = {"warning": len(self.card.warnings), "note": len(self.card.notes)}
        remarks = [f"{n} {word}{'s' * (n > 1)}" for word, n in counts.items() if n]
        last = f"\n{' and '.join(remarks)}: print(result.card.text())" if remarks else ""
        return f"Result of {self.system.name}{end}: {self.trace.extent}\n{self.card!r}{last}"

    def _repr_html_(self) -> str:
        shown = Trace(self.time, self.trace.signals, self.units)._repr_html_()
        title = f"<b>{escape(self.system.name)}</b>{'' if self.complete else ', ended early'}"
        return f"{title}{self.card._repr_html_()}{shown}"

    def to_pandas(self) -> pd.DataFrame:
        """As `Trace.to_pandas`: a column for each signal, the time [s] as index, units in `attrs`."""
        return self.trace.to_pandas()

    def to_xarray(self) -> xr.Dataset:
        """As `Trace.to_xarray`: a dataset of the signals with their units."""
        return self.trace.to_xarray()

    def plot(self, *patterns: str | Sequence[str], **options: Unpack[FigureArguments]) -> Figure:
        """Recorded signals over time as a matplotlib figure, with their band; arguments of `Trace.figure`."""
        given: FigureArguments = {"title": self.system.name, "band": self.band, **options}
        return self.trace.plot(*patterns, **given)

    @property
    def band(self) -> Trace | None:
        """Half width of a band around each signal of `errors`, shape (n,); None without them.

        Twice the largest estimated error among the evaluations nearby. `python -m benchmarks.calibration`
        prints the share of points at which the truth is inside.
        """
        if self.errors is None:
            return None
        near = {n: np.pad(np.abs(e), NEARBY) for n, e in self.errors.signals.items()}
        signals = {name: BAND * largest(values, 2 * NEARBY + 1) for name, values in near.items()}
        return Trace(self.errors.time, signals, self.errors.units).at(self.trace.time)


class RunFailed(Problem):
    """A run that ended early because of a problem; `result` has its record.

    final   other steps would not help: the process of the run has ended
    """

    def __init__(self, problem: Problem, result: Result, final: bool = False) -> None:
        super().__init__(str(problem))
        self.result, self.final = result, final


class Interrupted(KeyboardInterrupt):
    """A run or a batch that the user interrupted; `result` has its record until then."""

    def __init__(self, result: Any, message: str = "") -> None:
        """message: the call into an FMU that was in progress, if it did not end in time."""
        super().__init__(*filter(None, [message]))
        self.result = result


EQUAL_STEPS = (
    "change of the signals when the step is halved; at order p the error is 2^p / (2^p - 1) times this change"
)
ADAPTIVE_STEPS = (
    "change of the signals at a tenth of the tolerance; the error is 1.1 to 1.5 times this change"
)
BY_INPUTS = "estimated error of the coupling, from the errors of the inputs in each step"
FLOOR = 1e-12  # range, in any unit, below which a signal without a nominal value is constant
# Half width of the band of a signal: this number times the largest of an estimated error and its neighbours
BAND, NEARBY = 2.0, 5
# A bond exchanges no energy if its exchange is below
NO_EXCHANGE = 1e-9  # of the largest exchange of a bond,
NO_EXCHANGE_ENERGY = 1e-12  # or [J]
SMALL_EXCHANGE = 1e-2  # of the largest exchange of a bond: below it a relative residual has no meaning
# A result is not reliable if the energy error of a bond, over the exchanged energy, or the estimated RMS
# error of a signal of a bond, over its range or LEAST_RANGE of its nominal value, is above UNRELIABLE.
UNRELIABLE, LEAST_RANGE = 0.05, 1e-3
SHORTER, DIVIDED = "take shorter steps", "let steps be divided, --guard 0.005, or take shorter ones"  # advice
CAUSE = 0.1  # relative residual above which the coupling is the likely cause of a failure


@dataclass(frozen=True)
class BondEnergy:
    """Energies of one bond over a run [J].

    residual    energy error of the coupling; errors of opposite sign cancel
    turnover    sum of the magnitudes of the energy errors of all steps
    exchanged   integral of the magnitude of the power
    """

    name: str
    residual: float
    turnover: float
    exchanged: float

    @property
    def relative(self) -> float:
        """Residual over exchanged energy; 0 if none is exchanged."""
        return self.residual / self.exchanged if self.exchanged > 0 else 0.0


@dataclass(frozen=True)
class Unseen:
    """What an output that jumps does inside of steps, as a mean over the run, over its range.

    hidden   what is outside of the values at both ends of a step, beyond a tenth of the range
    late     changes by jumps, which other FMUs see up to a step late
    """

    hidden: float
    late: float

    @property
    def unreliable(self) -> bool:
        """Is it so much that the result is not reliable?"""
        return self.hidden + self.late > UNRELIABLE


@dataclass(frozen=True)
class EstimatedError:
    """The estimated error of one output over a run, in its unit: root mean square, and largest magnitude."""

    rms: float
    largest: float


@dataclass(frozen=True)
class SignalError:
    """The error of one signal that was estimated during the run, or its change when the step is halved.

    At order p the error is 2^p / (2^p - 1) times the change. For an adaptive run it is the change at a tenth
    of the tolerance. An error proportional to the tolerance is 1.1 times the change. An error proportional to
    its root (hermite, if FMUs hold inputs) is 1.5 times the change.

    largest, rms   largest and RMS error, or change, over the range of the signal
    change         largest error, or change, in `unit`
    order          measured order of convergence, from a third run at twice the step; None if unknown
    """

    name: str
    largest: float
    rms: float
    order: float | None = None
    unit: str = ""
    change: float = 0.0

    def relative_rms(self, nominal: float | None) -> float:
        """The RMS error over the range, or over a part of the nominal value if that is larger."""
        span = self.change / self.largest if self.largest else 0.0
        return self.rms * span / max(span, LEAST_RANGE * abs(nominal or 0.0)) if span else 0.0


@dataclass(frozen=True, kw_only=True)
class RunFigures:
    """What the accuracy card and the metadata of a run have in common. Times in [s].

    step          communication step, of adaptive runs the mean
    steps         number of accepted steps
    passes        number of passes over the components in accepted steps
    repeated      number of rejected steps
    lengths       shortest and longest step
    unreliable    why the result is not reliable, also in `warnings`; empty if it is
    inside        component -> wall time in its steps; the remaining wall time is coupling and recording
    """

    master: str
    step: float
    simulated: float = 0.0
    wall: float = 0.0
    inside: Mapping[str, float] = field(default_factory=dict)
    steps: int = 0
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)
    warnings: tuple[str, ...] = ()
    unreliable: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False, kw_only=True)
class Card(RunFigures):
    """The accuracy card of one run: speed, energy errors, error estimates, notes and warnings.

    record_step   [s]; 0: every communication point
    adaptive      tolerance of an adaptive run; None: all steps are equal
    errors        of signals; errors_of_inputs: estimated during the run, else changes in further runs
    events        of FMUs
    unseen        output -> what it does inside of steps
    """

    record_step: float = 0.0
    bonds: tuple[BondEnergy, ...] = ()
    notes: tuple[str, ...] = ()
    errors: tuple[SignalError, ...] = field(default=())
    adaptive: float | None = None
    errors_of_inputs: bool = False
    events: tuple[Event, ...] = ()
    texts: tuple[tuple[float, str, str], ...] = ()
    unseen: Mapping[str, Unseen] = field(default_factory=dict)

    def doubted(self, *reasons: str) -> Card:
        """This card with reasons why the result is not reliable."""
        new = tuple(reason for reason in reasons if reason not in self.unreliable)
        return replace(self, unreliable=(*self.unreliable, *new), warnings=(*new, *self.warnings))

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time: above 1 is faster than real time."""
        return self.simulated / self.wall if self.wall > 0 else float("inf")

    @property
    def worst(self) -> list[SignalError]:
        """The largest change of a signal in each unit."""
        groups = grouped(self.errors, lambda e: e.unit).values()
        return [max(errors, key=lambda e: e.change) for errors in groups]

    def __repr__(self) -> str:
        return "\n".join(self._speed())

    def _repr_html_(self) -> str:
        return f'<pre style="white-space: pre-wrap">{escape(self.text())}</pre>'

    def _speed(self) -> list[str]:
        """Master, steps and wall time."""
        return [
            f"master {self.master}, {self._steps()}, {self.simulated:.6g} s simulated",
            f"wall time {self.wall:.3g} s, {self.real_time_factor:.3g} times real time",
        ]

    def _steps(self) -> str:
        """Number and length of the steps, and number of passes and rejected steps."""
        if self.adaptive is None:
            text = f"step {self.step:.6g} s, {self.steps} steps"
        else:
            shortest, longest = (f"{1e3 * length:.3g}" for length in self.lengths)
            text = f"tolerance {self.adaptive:g}, {self.steps} steps of {shortest} to {longest} ms"
        if (passes := f"{self.passes / max(self.steps, 1):.3g}") not in ("0", "1"):
            text += f", {passes} passes each"
        text += f", {self.repeated} repeated" if self.repeated else ""
        count = len(self.events)
        return text + (f", {count} event{'s' * (count > 1)}" if count else "")

    def _error_lines(self) -> list[str]:
        """The worst error, or change, of a signal in each unit."""
        head, worst = ["worst signal of each unit"], self.worst
        if self.errors_of_inputs:
            head += ["largest", "", "of range", "rms of range"]
            rows = [[*_error_row(e)[:4], f"{e.rms:.1e}"] for e in worst]
            return ["", BY_INPUTS, *TextTable(head, rows).lines()]
        head += ["change", "", "of range", "order"]
        title, columns = (EQUAL_STEPS, 5) if self.adaptive is None else (ADAPTIVE_STEPS, 4)  # no order
        rows = [_error_row(e)[:columns] for e in worst]
        return ["", title, *TextTable(head[:columns], rows).lines()]

    def likely_cause(self, repeats: bool = False) -> str:
        """The coupling, for the message of a failed run, if a bond has a large energy error; else empty."""
        worst = max(bonds_above(self.bonds, CAUSE), key=lambda b: abs(b.relative), default=None)
        if worst is None:
            return ""
        error = f"energy error {worst.relative:+.0%} of the energy exchanged by {worst.name}"
        other = "" if repeats else " or the master hermite"
        cause = f"the coupling, {self.master} with a step of {self.step:.6g} s ({error})"
        return f"likely cause: {cause}; use a shorter step{other}"

    def bond(self, bond: BondEnergy) -> tuple[str, str, str]:
        """Energy error of the coupling [J], energy exchanged [J], and their ratio."""
        most = max(b.exchanged for b in self.bonds)
        if bond.exchanged <= max(NO_EXCHANGE_ENERGY, NO_EXCHANGE * most):
            return "", "", "no exchange"
        relative = f"{bond.relative:.1e}" if bond.exchanged >= SMALL_EXCHANGE * most else "-"
        return f"{bond.residual:.3g}", f"{bond.exchanged:.4g}", relative

    def text(self) -> str:
        """The card as lines of text."""
        lines = self._speed()
        if self.inside:
            times = (f"{name} {time:.2g} s" for name, time in self.inside.items())
            lines += [f"inside the FMUs {sum(self.inside.values()):.2g} s: {', '.join(times)}"]
        if rows := [row for b in self.bonds if (row := [b.name, *self.bond(b)])[1]]:
            lines += ["", *TextTable(["power bond", "residual [J]", "exchanged [J]", "share"], rows).lines()]
        elif self.bonds:
            lines += ["", "no power bond exchanges energy"]
        lines += self._error_lines() if self.errors else []
        lines += ["", *(f"note: {n}" for n in self.notes)] if self.notes else []
        lines += ["", *(f"warning: {w}" for w in self.warnings)] if self.warnings else []
        return "\n".join(lines)


@dataclass
class RunEnd:
    """How a run ended, without its rows.

    t             simulated until this time [s]
    steps, ...    as in `Card`
    errors        estimated during the run, by output
    unseen        output -> what it does inside of steps
    events        that were handled, by time
    logs          messages of the FMUs
    notes         remarks on the run
    problem       why the run ended early; None if it is complete
    interrupted   the user ended it
    died          the process of the run has ended
    closing       what an FMU did after the run was complete, such as a crash when it was freed
    """

    t: float
    steps: int = 0
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)
    wall: float = 0.0
    bonds: tuple[BondEnergy, ...] = ()
    errors: Mapping[str, EstimatedError] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)
    unseen: Mapping[str, Unseen] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    texts: tuple[tuple[float, str, str], ...] = ()
    logs: tuple[Log, ...] = ()
    notes: tuple[str, ...] = ()
    problem: Problem | None = None
    interrupted: bool = False
    died: bool = False
    closing: str = ""

    @property
    def complete(self) -> bool:
        """Did the run reach its stop time, or the time at which an FMU asked to end it?"""
        return self.problem is None and (not self.interrupted or bool(self.closing))


def bonds_above(bonds: Sequence[BondEnergy], limit: float) -> list[BondEnergy]:
    """The bonds whose relative energy error exceeds `limit`."""
    residual, exchanged = np.array([(b.residual, b.exchanged) for b in bonds]).reshape(-1, 2).T
    return [b for b, above in zip(bonds, energies_above(residual, exchanged, limit), strict=True) if above]


def energies_above(residual: Array, exchanged: Array, limit: float = UNRELIABLE) -> NDArray[np.bool_]:
    """Where energy errors [J] exceed `limit` of the exchanged energies [J], both of the shape (bonds, ...).

    A bond that exchanges less than SMALL_EXCHANGE of the largest exchange, or no energy, does not count.
    """
    most = np.max(exchanged, axis=0, initial=0.0)
    relevant = exchanged > np.maximum(NO_EXCHANGE_ENERGY, SMALL_EXCHANGE * most)
    return np.asarray(relevant & (np.abs(residual) > limit * exchanged))


def unreliable_energies(bonds: Sequence[BondEnergy], advice: str = SHORTER) -> list[str]:
    """A line for each bond whose energy error is too large for a reliable result."""
    return [
        f"energy error of the coupling: {b.relative:+.1%} of what {b.name} exchanged; the result is not"
        f" reliable, {advice}"
        for b in bonds_above(bonds, UNRELIABLE)
    ]


def unseen_notes(unseen: Mapping[str, Unseen]) -> list[str]:
    """A line on the outputs that jump, or have short pulses, inside of steps."""
    names = first_names(name for name, found in unseen.items() if not found.unreliable)
    return [f"jumps inside of steps, with effects up to a step late: {names}"] * bool(names)


def unreliable_outputs(unseen: Mapping[str, Unseen]) -> list[str]:
    """A line on the outputs that jump so much that the result is not reliable."""
    names = first_names(name for name, found in unseen.items() if found.unreliable)
    told = f"jumps inside of steps, which other FMUs do not see in time: {names}"
    return [f"{told}; the result is not reliable, take much shorter steps"] * bool(names)


def unreliable_errors(errors: Sequence[SignalError], system: System) -> list[str]:
    """A line on the signals of power bonds whose estimated errors are too large for a reliable result."""
    ports, nominals = {p for b in find_bonds(system) for p in (b.effort, b.flow)}, system.nominals
    names = {str(c.source) for c in system.connections if c.target in ports}
    shares = {e.name: e.relative_rms(nominals.get(e.name)) for e in errors if e.name in names}
    if not (large := {name: share for name, share in shares.items() if share > UNRELIABLE}):
        return []
    worst = max(large.values())
    return [
        f"estimated error of the coupling: RMS {worst:.1%} of the range of {first_names(large)}; the result"
        " is not reliable, take shorter steps"
    ]


def signal_errors(
    fine: Trace,
    trace: Trace,
    coarse: Trace | None = None,
    nominals: Mapping[str, float | None] | None = None,
) -> tuple[SignalError, ...]:
    """Error estimates for `trace` from a run at half its step and, for the order, one at twice its step.

    Runs are compared at the points that both recorded. Constant signals (see `ranges`) are left out. A signal
    whose change is at the level of rounding has no order.
    """
    errors = []
    changes = _changes(fine, trace)
    before = _changes(trace, coarse.select(trace.signals)) if coarse else {}
    for name, span in ranges(fine.select(trace.signals), nominals or {}).items():
        largest, size = float(np.max(np.abs(changes[name]))), rms(changes[name])
        larger = rms(before[name]) if name in before else 0.0  # the change from 2h to h
        order = float(np.log2(larger / size)) if size >= 1e-11 * span and larger > 0 else None
        unit = fine.units.get(name, "")
        errors.append(SignalError(name, largest / span, size / span, order, unit, largest))
    return tuple(errors)


def changes(coarse: Result | None, run: Result, fine: Result) -> tuple[SignalError, ...]:
    """Changes of the outputs from a run to one at half the step; orders, if there is one at twice."""
    nominals = run.system.nominals
    outputs = run.trace.select(name for name in nominals if name in run.trace.signals)
    return signal_errors(fine.trace, outputs, None if coarse is None else coarse.trace, nominals)


def relative_errors(
    errors: Mapping[str, EstimatedError], trace: Trace, nominals: Mapping[str, float | None]
) -> tuple[SignalError, ...]:
    """Errors that were estimated during a run, over the ranges of its signals without the constant ones."""
    recorded = trace.select(name for name in errors if name in trace.signals)
    return tuple(
        SignalError(name, e.largest / span, e.rms / span, None, trace.units.get(name, ""), e.largest)
        for name, span in ranges(recorded, nominals).items()
        if (e := errors[name]).largest
    )


def ranges(trace: Trace, nominals: Mapping[str, float | None]) -> dict[str, float]:
    """The range of each signal that moves, relative to its nominal value, else to the signals of its unit."""
    spans = {name: float(np.ptp(values)) for name, values in trace.signals.items()}
    widest = widest_of_unit(spans, trace.units)
    least = {name: CONSTANT_OF_NOMINAL * abs(nominals.get(name) or 0.0) for name in spans}
    return {n: span for n, span in spans.items() if span > (least[n] or max(CONSTANT * widest[n], FLOOR))}


def widest_of_unit(spans: Mapping[str, float], units: Mapping[str, str]) -> dict[str, float]:
    """Signal -> the largest of the ranges of all signals in its unit."""
    groups = grouped(spans, lambda name: units.get(name, "")).values()
    return {name: max(spans[n] for n in names) for names in groups for name in names}


def _changes(fine: Trace, trace: Trace) -> dict[str, NDArray[np.float64]]:
    """Finer less coarser run, for each signal; halving a step keeps the common times bit-identical."""
    _, a, b = np.intersect1d(fine.time, trace.time, assume_unique=True, return_indices=True)
    return {name: fine[name][a] - values[b] for name, values in trace.signals.items()}


def _error_row(e: SignalError) -> list[str]:
    order = "" if e.order is None else f"{e.order:.2f}"
    return [e.name, f"{e.change:.2e}", e.unit, f"{e.largest:.1e}", order]


@dataclass(frozen=True, kw_only=True)
class RunMetadata(RunFigures):
    """Metadata of one run, as written next to its trace.

    coupling                             all choices about the coupling that have an effect, by name
    fmus                                 component -> model name of its FMU
    swapped                              component -> file of the FMU that replaces the one of the system
    given                                the user's options that differ from the defaults
    units                                units of the signals; `inputs`: signals that are inputs of components
    provenance                           files with checksums, values that differ from the shipped ones
    sources                              signals of `inputs` that no other component with inputs computes
    nominals                             nominal values that the FMUs declare for the signals
    """

    system: str
    complete: bool = True
    fmus: Mapping[str, str] = field(default_factory=dict)
    swapped: Mapping[str, str] = field(default_factory=dict)
    given: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    coupling: Mapping[str, Any] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    sources: tuple[str, ...] = ()
    nominals: Mapping[str, float] = field(default_factory=dict)

    @property
    def adaptive(self) -> bool:
        """Did the run have adaptive steps?"""
        return "adaptive" in self.coupling


def metadata(
    result: Result,
    options: RunOptions | None = None,
    signals: RowLayout | None = None,
    scenario: Path | None = None,
) -> RunMetadata:
    """The metadata of a run; options, scenario: the user's; default of `signals`: those of the trace."""
    signals = signals or RowLayout(tuple(result.trace.signals), result.trace.units)
    system, card = result.system, result.card
    inputs = [p for p in system.ports("input") if str(p) in signals.names]
    interfaces = {name: component.interface for name, component in system.components.items()}
    computed = {c.target for c in system.connections if interfaces[c.source.component].of("input")}
    ports = [p for p in (*system.ports("output"), *inputs) if str(p) in signals.names]
    return RunMetadata(
        system=str(system.source.path if system.source else system.name),
        **{entry.name: getattr(card, entry.name) for entry in fields(RunFigures)},
        complete=result.complete,
        fmus={c.name: c.interface.identifier for c in system.components.values()},
        swapped={c.name: str(c.source) for c in system.components.values() if c.replaced},
        given=(given(options) if options else {}) | ({"scenario": scenario} if scenario else {}),
        units=signals.units,
        inputs=tuple(map(str, inputs)),
        coupling=result.coupling.settings,
        provenance=result.provenance,
        sources=tuple(str(p) for p in inputs if p not in computed),
        nominals={
            str(p): n for p in ports if (n := system.components[p.component].interface.nominal(p.variable))
        },
    )


def metadata_file(trace: Path) -> Path:
    """The metadata file of a trace."""
    return trace.with_suffix(METADATA_SUFFIX)


def metadata_text(
    result: Result,
    sha256: str,
    options: RunOptions | None = None,
    signals: RowLayout | None = None,
    scenario: Path | None = None,
) -> str:
    """The metadata of a run, for the file next to its trace with this checksum."""
    data = {"sha256": sha256} | asdict(metadata(result, options, signals, scenario))
    return json.dumps(data, indent=1, ensure_ascii=False, default=str) + "\n"


MAX_HEADING = 1000  # bytes of a line, far more than those of the headings below
EVENTS, TEXTS = ("time", "causes"), ("time", "signal", "text")  # headings of files


def write_events(card: Card, trace: Path) -> None:
    """Write events, and changes of texts, next to a trace; without any, remove those of an earlier run."""
    events = [(e.time, " ".join(e.causes)) for e in card.events]
    for kind, head, rows in (("events", EVENTS, events), ("texts", TEXTS, card.texts)):
        file = trace.with_suffix(f".{kind}.csv")
        if rows:
            lines = StringIO()
            csv.writer(lines, lineterminator="\n").writerows([head, *rows])
            write_whole(file, lines.getvalue())
        elif file.is_file():
            with Location(file).opened() as stream:
                found = stream.readline(MAX_HEADING).strip()
            if found == ",".join(head).encode():  # it could be a trace of another name
                file.unlink()


def read_metadata(path: Path) -> RunMetadata | None:
    """The metadata of the run that made a trace, next to it, else inside; None if there are none.

    Metadata next to a trace with another checksum are those of another trace; both may be renamed.
    """
    file = metadata_file(path)
    if file.is_file():
        loaded, digest = _parsed(file, Location(file).text())
        if digest == Location(path).sha256:
            return loaded
    inside = read_origin(path)
    return _parsed(path, inside)[0] if inside else None


def _parsed(file: Path, text: str) -> tuple[RunMetadata, str]:
    """Metadata in a JSON text, and the checksum of their trace."""
    try:
        data = json.loads(text)
        digest = data.pop("sha256")
        data.pop("names", None)  # of a MATLAB file
        tuples = {name: tuple(data.get(name, ())) for name in ("inputs", "warnings", "unreliable", "sources")}
        origins = Provenance.of(data.get("provenance", {}))
        return RunMetadata(**{**data, **tuples, "provenance": origins}), digest
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise Problem(f"{file}: expected what harvester run writes next to a trace, got {error!r}") from None


def read_run(path: Path) -> tuple[Trace, RunMetadata | None]:
    """The trace in a file, with the units of its run, and the metadata of the run if there are any."""
    return read_trace(path), read_metadata(path)


def newest_trace(folder: Path) -> Path | None:
    """The trace in a folder that a run wrote last, known by the metadata next to it; None without one."""
    stems = [file.name.removesuffix(METADATA_SUFFIX) for file in folder.glob(f"*{METADATA_SUFFIX}")]
    traces = [folder / f"{stem}{suffix}" for stem in stems for suffix in SUFFIXES]
    complete = [t for t in traces if t.is_file() and not t.stem.endswith(".partial")]
    return max(complete, key=lambda trace: trace.stat().st_mtime, default=None)
