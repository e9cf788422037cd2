"""Options of runs and of other studies of a system, declared once for Python, the command line and files.

A group is a frozen record of what was chosen, in SI units; its docstring has the text of each option.
The keywords that fill a group, as a type checker wants them, are in engine/arguments.py, made from this file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from orchestrator.base.options import (
    GROUPS,
    Faults,
    Kind,
    Patterns,
    Seconds,
    Sets,
    Swaps,
    Tolerance,
    Values,
)
from orchestrator.ssp.coupling import CouplingOptions


@dataclass(frozen=True, kw_only=True)
class SystemOptions:
    """Variants, parameters and connections of a system.

    swap         Replace the FMU of a component by a variant, such as boom_stick=detailed, or by a file,
                 boom_stick=FILE.fmu; default: the FMUs in the system.
    parameters   Parameter set of the system, such as reach, or a file FILE.ssv; later ones override; default:
                 the values in the system.
    set          Start value of COMPONENT.VARIABLE, such as manipulator.head_mass=600. A name without a
                 component sets all inputs of this name (supply_pressure) or a parameter that components share
                 (boom_stroke). Unit: that of `harvester signals`, or given, such as
                 supply.pressure_setting=180bar.
    cut          Remove the connections to the inputs that match: '*_rate' matches the variable, and with a
                 dot 'swing.*_rate' COMPONENT.VARIABLE; default: none.
    """

    swap: Swaps = field(default_factory=dict)
    parameters: Sets = ()
    set: Values = field(default_factory=dict)
    cut: Patterns = ()


@dataclass(frozen=True, kw_only=True)
class SpanOptions:
    """The time span of a run.

    start   Start time [s]; default: the start time in the system, else 0.
    stop    Stop time [s]; default: the end of the scenario, else the stop time in the system or its FMUs.
    yes     Run to the end of a scenario that is so long that its times may be in ms.
    """

    start: Seconds = None
    stop: Seconds = None
    yes: bool = False


@dataclass(frozen=True, kw_only=True)
class StepOptions:
    """Communication step, and time between recorded points.

    step          Communication step [s], with `adaptive` the first one; default: the step in the system or
                  its FMUs, 1e-3 for the harvester.
    record_step   Time between recorded points [s], a multiple of the step, with `adaptive` any time; default:
                  every step. Commands record every 0.005 s; only `harvester run` with `adaptive` records
                  every step.
    """

    step: Seconds = None
    record_step: Seconds = None


DEFAULT_ACCURACY = {"run": 1e-3, "sweep": 1e-3, "validate": 1e-4}  # of the commands


@dataclass(frozen=True, kw_only=True)
class AccuracyOptions:
    """How accurate a run is to be, in place of coupling, step and tolerance.

    accuracy      Largest RMS error over the range of a signal, such as 1e-3: master, step and FMU tolerance
                  follow from it. Default of the commands, if neither options nor the system choose master or
                  step, and all FMUs have directional derivatives: 1e-3, validate: 1e-4.
    accuracy_of   With `accuracy`: the outputs that it applies to, such as '*_speed', or with component
                  'manipulator.*_speed'; default: the velocities of power bonds, else all outputs.
    """

    accuracy: Annotated[float | None, Kind("ERROR")] = None
    accuracy_of: Patterns = ()


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """The solvers in the FMUs.

    tolerance   Relative tolerance of the solvers in the FMUs; default: with `accuracy` 0.03 of it, else the
                tolerance in the DefaultExperiment of each FMU.
    """

    tolerance: Tolerance = None


@dataclass(frozen=True, kw_only=True)
class LimitOptions:
    """Estimate of errors, and limits of a run.

    error_estimate   Estimate the error of the outputs that the coupling causes. If an FMU has no directional
                     derivatives, repeat the run at half and at twice the step, and print the change of the
                     signals.
    time_limit       Limit of the wall time of the run [s]; default: no limit.
    memory_limit     Memory limit of the process that runs the FMUs [GB, 1e9 bytes]; default: the memory of
                     the computer.
    """

    error_estimate: bool | Literal["fast"] = False
    time_limit: Annotated[float, Kind("T", "s")] = inf
    memory_limit: Annotated[float, Kind("GB", "GB", most=1e6)] = inf  # more is meant in bytes


@dataclass(frozen=True, kw_only=True)
class EndOptions:
    """When a run ends before its stop time.

    until   End at the first recorded row where a condition holds: SIGNAL < NUMBER, such as
            'manipulator.tip_height < -1.5 m', or > <= >=. In Python also a function of the time [s] and of
            the row, a mapping from signal to value, which hears of every recorded row and may return True;
            with `accuracy` of those of every run of the search.
    """

    until: Annotated[str | Callable[[float, Mapping[str, float]], Any] | None, Kind("CONDITION")] = None


@dataclass(frozen=True, kw_only=True)
class StateOptions:
    """A run in parts.

    save_state   Write the state of the run to a file, FILE@TIME such as run.state@21s; without a time at its
                 end.
    resume       Go on from the state in such a file, with the same system, master and step, also in another
                 process: bit for bit the run that was saved.
    """

    save_state: Annotated[str | Path | None, Kind("FILE@TIME")] = None
    resume: Annotated[str | Path | None, Kind("FILE")] = None


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """What changes during a run.

    fault   Input that takes a value during the run, such as boom_head_leak=2mm2@20s of a machine that was
            built with faults; without a time from the start. Several values in sequence:
            boom_head_leak=2mm2@20s,0@30s.
    """

    fault: Faults = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ProcessOptions:
    """Options of a run in Python only.

    record      Patterns of the signals to record, or patterns such as "boom_*"; default: all outputs, all
                connected inputs and all inputs of the system.
    bonds       Power bonds, as pairs of input names, whose energy error is recorded; default: those that
                follow from the units.
    progress    Show a progress bar if the run takes longer than a second.
    isolate     Run in a process of its own, so that an FMU that crashes ends only that process; default: yes.
    open        Opens a component: returns an FMU, or any object with the methods of
                `orchestrator.fmi.calls.Slave`; a function other than `open_slave` needs this process.
    """

    record: Patterns | None = None
    bonds: tuple[tuple[str, str], ...] | None = None
    progress: bool = False
    isolate: bool = True
    open: Callable[[Any], Any] | None = None


@dataclass(frozen=True, kw_only=True)
class CaseOptions(SystemOptions, SpanOptions):
    """What is run: variants, parameters, connections, time span."""


@dataclass(frozen=True, kw_only=True)
class CoupledOptions(CaseOptions, StepOptions, AccuracyOptions):
    """What a co-simulation runs, how accurate, and how it is coupled."""

    coupling: CouplingOptions = CouplingOptions()  # noqa: RUF009  frozen


@dataclass(frozen=True, kw_only=True)
class CommandOptions(CoupledOptions, FaultOptions, SolverOptions, LimitOptions, EndOptions, StateOptions):
    """Options of the command `run`."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(CommandOptions, ProcessOptions):
    """Options of `run`."""


@dataclass(frozen=True, kw_only=True)
class MachinesOptions(SystemOptions, StepOptions, SolverOptions):
    """Options of machines that are simulated at once.

    workers   Number of cores to use; default: all.
    """

    coupling: CouplingOptions = CouplingOptions()  # noqa: RUF009  frozen
    workers: int | None = None


@dataclass(frozen=True, kw_only=True)
class BatchOptions(MachinesOptions, SpanOptions):
    """Options of `batch`.

    time_limit     Limit of the wall time of all machines together [s]; the others end there as failed;
                   default: no limit.
    memory_limit   Memory limit of each process that runs machines one by one [GB, 1e9 bytes]; default: the
                   memory of the computer.
    """

    time_limit: Annotated[float, Kind("T", "s")] = inf
    memory_limit: Annotated[float, Kind("GB", "GB", most=1e6)] = inf


@dataclass(frozen=True, kw_only=True)
class ReferenceOptions(CaseOptions):
    """Options of `reference`.

    record_step   Time between recorded points [s]; default: 0.005.
    tolerance     Relative tolerance of the solver, 1e-14 to 1e-2, and absolute, times the magnitude that the
                  FMU gives for each state; default: 2e-14.
    """

    record_step: Annotated[float, Kind("T", "s")] = 0.005
    tolerance: Annotated[float, Kind("TOL")] = 2e-14


@dataclass(frozen=True, kw_only=True)
class LinearOptions(SystemOptions):
    """Options of `linearize`.

    inputs    Input of the linear model, COMPONENT.VARIABLE or all inputs with this name; its connection is
              removed; default: the inputs of the system, and the inputs that are connected to operator_input.
    outputs   Outputs that match, such as '*_angle', or with component 'manipulator.*'; default: all.
    steady    Linearize at the steady state with the joint angles of the operating point; all other states are
              computed.
    speeds    With `steady`: constant speed of a joint [rad/s], such as boom=0.1; default: 0.
    time      Linearize at this time of a run [s]; default: at the start.
    step      With `time`: communication step of that run [s]; default: the step in the system or its FMUs.
    """

    inputs: Annotated[tuple[str, ...], Kind("NAME", flags=("--input",))] = ()
    outputs: Annotated[tuple[str, ...], Kind("PATTERN", flags=("--output",))] = ()
    steady: bool = False
    speeds: Annotated[
        Mapping[str, float],
        Kind("JOINT=V", flags=("--speed",), form="joint=speed, such as boom=0.1"),
    ] = field(default_factory=dict)
    time: Seconds = None
    step: Seconds = None


GROUPS += [
    *(SystemOptions, SpanOptions, StepOptions, AccuracyOptions, SolverOptions, LimitOptions),
    *(EndOptions, StateOptions, FaultOptions, ProcessOptions, MachinesOptions),
]

Group = TypeVar("Group")


def same(group: type[Group], options: object) -> Group:
    """The choices of another group that this one has, too."""
    names = [f.name for f in fields(group) if hasattr(options, f.name)]  # type: ignore[arg-type]  # a dataclass
    return group(**{name: getattr(options, name) for name in names})
