"""Options of runs and of other studies of a system, declared once for Python, the command line and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from orchestrator.base.options import (
    GROUPS,
    Faults,
    Kind,
    Number,
    Patterns,
    Seconds,
    Sets,
    Swaps,
    Tolerance,
    Values,
)
from orchestrator.ssp.coupling import CouplingArguments


class SystemArguments(TypedDict, total=False):
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

    swap: Swaps
    parameters: Sets
    set: Values
    cut: Patterns


class SpanArguments(TypedDict, total=False):
    """The time span of a run.

    start   Start time [s]; default: the start time in the system, else 0.
    stop    Stop time [s]; default: the end of the scenario, else the stop time in the system or its FMUs.
    yes     Run to the end of a scenario that is so long that its times may be in ms.
    """

    start: Seconds
    stop: Seconds
    yes: bool | None


class StepArguments(TypedDict, total=False):
    """Communication step, and time between recorded points.

    step          Communication step [s], with `adaptive` the first one; default: the step in the system or
                  its FMUs, 1e-3 for the harvester.
    record_step   Time between recorded points [s], a multiple of the step, with `adaptive` any time; default:
                  every step. Commands record every 0.005 s; only `harvester run` with `adaptive` records
                  every step.
    """

    step: Seconds
    record_step: Seconds


DEFAULT_ACCURACY = {"run": 1e-3, "sweep": 1e-3, "validate": 1e-4}  # of the commands


class AccuracyArguments(TypedDict, total=False):
    """How accurate a run is to be, in place of coupling, step and tolerance.

    accuracy      Largest RMS error over the range of a signal, such as 1e-3: master, step and FMU tolerance
                  follow from it. Default of the commands, if neither options nor the system choose master or
                  step, and all FMUs have directional derivatives: 1e-3, validate: 1e-4.
    accuracy_of   With `accuracy`: the outputs that it applies to, such as '*_speed', or with component
                  'manipulator.*_speed'; default: the velocities of power bonds, else all outputs.
    """

    accuracy: Annotated[float | None, Kind("ERROR")]
    accuracy_of: Patterns


class SolverArguments(TypedDict, total=False):
    """The solvers in the FMUs.

    tolerance   Relative tolerance of the solvers in the FMUs; default: with `accuracy` 0.03 of it, else the
                tolerance in the DefaultExperiment of each FMU.
    """

    tolerance: Tolerance


class LimitArguments(TypedDict, total=False):
    """Estimate of errors, and limits of a run.

    error_estimate   Estimate the error of the outputs that the coupling causes. If an FMU has no directional
                     derivatives, repeat the run at half and at twice the step, and print the change of the
                     signals.
    time_limit       Limit of the wall time of the run [s]; default: no limit.
    memory_limit     Memory limit of the process that runs the FMUs [GB, 1e9 bytes]; default: the memory of
                     the computer.
    """

    error_estimate: bool | Literal["fast"] | None
    time_limit: Seconds
    memory_limit: Annotated[float | None, Kind("GB", "GB", most=1e6)]  # more is meant in bytes


class EndArguments(TypedDict, total=False):
    """When a run ends before its stop time.

    until   End at the first recorded row where a condition holds: SIGNAL < NUMBER, such as
            'manipulator.tip_height < -1.5 m', or > <= >=. In Python also a function of the time [s] and of
            the row, a mapping from signal to value, which hears of every recorded row and may return True;
            with `accuracy` of those of every run of the search.
    """

    until: Annotated[str | Callable[[float, Mapping[str, float]], Any] | None, Kind("CONDITION")]


class StateArguments(TypedDict, total=False):
    """A run in parts.

    save_state   Write the state of the run to a file, FILE@TIME such as run.state@21s; without a time at its
                 end.
    resume       Go on from the state in such a file, with the same system, master and step, also in another
                 process: bit for bit the run that was saved.
    """

    save_state: Annotated[str | Path | None, Kind("FILE@TIME")]
    resume: Annotated[str | Path | None, Kind("FILE")]


class FaultArguments(TypedDict, total=False):
    """What changes during a run.

    fault   Input that takes a value during the run, such as boom_head_leak=2mm2@20s of a machine that was
            built with faults; without a time from the start. Several values in sequence:
            boom_head_leak=2mm2@20s,0@30s.
    """

    fault: Faults


class ProcessArguments(TypedDict, total=False):
    """Options of a run in Python only.

    record      Names of the signals to record, or patterns such as "boom_*"; default: all outputs, all
                connected inputs and all inputs of the system.
    bonds       Power bonds, as pairs of input names, whose energy error is recorded; default: those that
                follow from the units.
    progress    Show a progress bar if the run takes longer than a second.
    isolate     Run in a process of its own, so that an FMU that crashes ends only that process; default: yes.
    open        Opens a component: returns an FMU, or any object with the methods of
                `orchestrator.fmi.calls.Slave`; a function other than `open_slave` needs this process.
    """

    record: Patterns
    bonds: Sequence[tuple[str, str]] | None
    progress: bool | None
    isolate: bool | None
    open: Callable[[Any], Any] | None


class CaseArguments(SystemArguments, SpanArguments, total=False):
    """What is run: variants, parameters, connections, time span."""


class CoupledArguments(CaseArguments, StepArguments, AccuracyArguments, CouplingArguments, total=False):
    """What a co-simulation runs, how accurate, and how it is coupled."""


class CommandArguments(
    CoupledArguments,
    FaultArguments,
    SolverArguments,
    LimitArguments,
    EndArguments,
    StateArguments,
    total=False,
):
    """Options of the command `run`."""


class RunArguments(CommandArguments, ProcessArguments, total=False):
    """Options of `run`."""


class MachinesArguments(SystemArguments, StepArguments, SolverArguments, CouplingArguments, total=False):
    """Options of machines that are simulated at once.

    workers   Number of cores to use; default: all.
    """

    workers: int | None


class BatchArguments(MachinesArguments, SpanArguments, total=False):
    """Options of `batch`.

    time_limit     Limit of the wall time of all machines together [s]; the others end there as failed;
                   default: no limit.
    memory_limit   Memory limit of each process that runs machines one by one [GB, 1e9 bytes]; default: the
                   memory of the computer.
    """

    time_limit: Seconds
    memory_limit: Annotated[float | None, Kind("GB", "GB", most=1e6)]


class ReferenceArguments(CaseArguments, total=False):
    """Options of `reference`.

    record_step   Time between recorded points [s]; default: 0.005.
    tolerance     Relative tolerance of the solver, 1e-14 to 1e-2, and absolute, times the magnitude that the
                  FMU gives for each state; default: 2e-14.
    """

    record_step: Seconds
    tolerance: Number


class LinearArguments(SystemArguments, total=False):
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

    inputs: Annotated[str | Sequence[str] | None, Kind("NAME", flags=("--input",))]
    outputs: Annotated[str | Sequence[str] | None, Kind("PATTERN", flags=("--output",))]
    steady: bool | None
    speeds: Annotated[
        Mapping[str, float] | None,
        Kind("JOINT=V", flags=("--speed",), form="joint=speed, such as boom=0.1"),
    ]
    time: Seconds
    step: Seconds


GROUPS += [
    *(SystemArguments, SpanArguments, StepArguments, AccuracyArguments, SolverArguments, LimitArguments),
    *(EndArguments, StateArguments, FaultArguments, ProcessArguments, MachinesArguments),
]
