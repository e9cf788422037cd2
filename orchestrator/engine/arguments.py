"""Keywords of functions that simulate, as type checkers want them: engine/options.py.

Made by tools/keywords.py. A number with a unit may be a text, such as "1 ms", and several values may be one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

from orchestrator.base.options import KEYWORDS
from orchestrator.engine import options
from orchestrator.ssp.coupling import Coupling, CouplingOptions
from orchestrator.ssp.masters import Master


class CouplingArguments(TypedDict, total=False):
    """Keywords of `CouplingOptions`."""

    master: Coupling | str | Master | None
    order: int | None
    passes: int | None
    coupling_tolerance: float | None
    factors: Mapping[str, int] | None
    adaptive: float | None
    guard: float | None
    smallest: float | str | None
    largest: float | str | None


class SystemArguments(TypedDict, total=False):
    """Keywords of `SystemOptions`."""

    swap: Mapping[str, str | Path] | None
    parameters: str | Path | Sequence[str | Path] | None
    set: Mapping[str, float | bool | str] | None
    cut: str | Sequence[str] | None


class SpanArguments(TypedDict, total=False):
    """Keywords of `SpanOptions`."""

    start: float | str | None
    stop: float | str | None
    yes: bool | None


class StepArguments(TypedDict, total=False):
    """Keywords of `StepOptions`."""

    step: float | str | None
    record_step: float | str | None


class AccuracyArguments(TypedDict, total=False):
    """Keywords of `AccuracyOptions`."""

    accuracy: float | None
    accuracy_of: str | Sequence[str] | None


class SolverArguments(TypedDict, total=False):
    """Keywords of `SolverOptions`."""

    tolerance: float | None


class LimitArguments(TypedDict, total=False):
    """Keywords of `LimitOptions`."""

    error_estimate: bool | Literal["fast"] | None
    time_limit: float | str | None
    memory_limit: float | str | None


class EndArguments(TypedDict, total=False):
    """Keywords of `EndOptions`."""

    until: str | Callable[[float, Mapping[str, float]], Any] | None


class StateArguments(TypedDict, total=False):
    """Keywords of `StateOptions`."""

    save_state: str | Path | None
    resume: str | Path | None


class FaultArguments(TypedDict, total=False):
    """Keywords of `FaultOptions`."""

    fault: Mapping[str, float | str] | None


class ProcessArguments(TypedDict, total=False):
    """Keywords of `ProcessOptions`."""

    record: str | Sequence[str] | None
    bonds: Sequence[tuple[str, str]] | None
    progress: bool | None
    isolate: bool | None
    open: Callable[[Any], Any] | None


class CaseArguments(SystemArguments, SpanArguments, total=False):
    """Keywords of `CaseOptions`."""


class CoupledArguments(CaseArguments, StepArguments, AccuracyArguments, CouplingArguments, total=False):
    """Keywords of `CoupledOptions`."""


class CommandArguments(
    CoupledArguments,
    FaultArguments,
    SolverArguments,
    LimitArguments,
    EndArguments,
    StateArguments,
    total=False,
):
    """Keywords of `CommandOptions`."""


class RunArguments(CommandArguments, ProcessArguments, total=False):
    """Keywords of `RunOptions`."""


class MachinesArguments(SystemArguments, StepArguments, SolverArguments, CouplingArguments, total=False):
    """Keywords of `MachinesOptions`."""

    workers: int | None


class BatchArguments(MachinesArguments, SpanArguments, total=False):
    """Keywords of `BatchOptions`."""

    time_limit: float | str | None
    memory_limit: float | str | None


class ReferenceArguments(CaseArguments, total=False):
    """Keywords of `ReferenceOptions`."""

    record_step: float | str | None
    tolerance: float | None


class LinearArguments(SystemArguments, total=False):
    """Keywords of `LinearOptions`."""

    inputs: str | Sequence[str] | None
    outputs: str | Sequence[str] | None
    steady: bool | None
    speeds: Mapping[str, float] | None
    time: float | str | None
    step: float | str | None


KEYWORDS |= {
    CouplingArguments: CouplingOptions,
    SystemArguments: options.SystemOptions,
    SpanArguments: options.SpanOptions,
    StepArguments: options.StepOptions,
    AccuracyArguments: options.AccuracyOptions,
    SolverArguments: options.SolverOptions,
    LimitArguments: options.LimitOptions,
    EndArguments: options.EndOptions,
    StateArguments: options.StateOptions,
    FaultArguments: options.FaultOptions,
    ProcessArguments: options.ProcessOptions,
    CaseArguments: options.CaseOptions,
    CoupledArguments: options.CoupledOptions,
    CommandArguments: options.CommandOptions,
    RunArguments: options.RunOptions,
    MachinesArguments: options.MachinesOptions,
    BatchArguments: options.BatchOptions,
    ReferenceArguments: options.ReferenceOptions,
    LinearArguments: options.LinearOptions,
}
