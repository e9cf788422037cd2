"""What the page shows: everything is handed in by the caller, nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmus.identification.known import Estimate, Finding
from fmus.identification.report.attribution import Explanation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One identified parameter: the estimate, the value before, and which procedure found it.

    prior, prior_source   value and source of the machine's own files, None if there is none
    """

    estimate: Estimate
    procedure: str
    prior: float | None = None
    prior_source: str = ""
    text: str = ""


@dataclass(frozen=True)
class Channel:
    """Data quality of one signal; remarks in whole sentences, empty if nothing is wrong.

    dead   share of the samples in the sensor's dead zone, which are not used
    """

    signal: str
    unit: str
    low: float
    high: float
    noise: float
    sensor: str = ""
    remarks: tuple[str, ...] = ()
    dead: float = 0.0


@dataclass(frozen=True)
class Quality:
    """Data quality of one recording."""

    name: str
    title: str
    procedure: str
    use: str
    kind: str
    duration: float
    rate: float
    channels: tuple[Channel, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def faults(self) -> int:
        """How many remarks there are."""
        return len(self.remarks) + sum(len(c.remarks) for c in self.channels)


@dataclass(frozen=True)
class Fit:
    """How well one signal is predicted: NRMSE over the range, None where there is no such recording.

    noise     root mean square of the training residual in standard deviations of the sensor
    memory    share of the lags at which the residual depends on its past beyond chance, 0.01 if white
    white     probability of such a memory if the residual were white [Ljung and Box]
    inputs    the largest such share for its correlation with an earlier input
    """

    signal: str
    train: float | None
    test: float | None
    noise: float | None = None
    memory: float | None = None
    white: float | None = None
    inputs: float | None = None


@dataclass(frozen=True)
class Start:
    """A search from another start point, on fewer samples: where it began, and where it ended.

    away        root mean square distance of the start from the values before, relative changes of parameters
    apart       largest distance of the end from the result, in standard deviations; infinite if there is none
    residual    root mean square residual at the end, in standard deviations of the sensors
    """

    name: str
    away: float
    apart: float
    residual: float
    iterations: int

    @property
    def same(self) -> bool:
        """Did it lead to the result, within a standard deviation?"""
        return self.apart < 1


@dataclass(frozen=True)
class Refinement:
    """The joint refinement.

    names, correlation   of the parameters, (n, n)
    unidentified         what the data cannot tell, whole sentences
    facts                method, seconds, samples ...: name -> text, in the order to show
    """

    names: tuple[str, ...]
    correlation: Array
    condition: float
    fits: tuple[Fit, ...]
    unidentified: tuple[str, ...] = ()
    starts: tuple[Start, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    title: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class Page:
    """Everything that the page shows.

    kinds      of the recordings: "simulation", "measurement", "published"
    pictures   measured and predicted traces
    commands   how to go on: command -> what it does
    remarks    what the reader must know first, whole sentences
    warnings   what makes the numbers doubtful and what to check, whole sentences
    """

    title: str
    source: str
    kinds: tuple[str, ...]
    findings: tuple[Finding, ...]
    parameters: tuple[Parameter, ...]
    qualities: tuple[Quality, ...] = ()
    refinement: Refinement | None = None
    explanation: Explanation | None = None
    pictures: tuple[Picture, ...] = ()
    commands: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
