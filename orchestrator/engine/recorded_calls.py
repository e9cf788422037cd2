"""FMUs whose calls from Python are recorded, so that a parent process can name the last one."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.base.errors import Problem
from orchestrator.engine.job import Opener
from orchestrator.fmi.calls import Slave, StepCalls
from orchestrator.fmi.cosimulation import CoSimulationFmu
from orchestrator.ssp.system import Component
from orchestrator.worker.activity import ActivityRecord


def recorded(activity: ActivityRecord, originals: Mapping[str, str] | None = None) -> Opener:
    """Opens FMUs for Co-Simulation whose calls are recorded with component and file.

    originals   unpacked FMU -> the file to name instead

    Calls of the loop in C are recorded as one, with all FMUs.
    """
    labels: list[str] = []

    class RecordedFmu(CoSimulationFmu):
        def stepping(self, rolls: bool) -> StepCalls:
            calls = super().stepping(rolls)
            activity.inputs(f"({', '.join(dict.fromkeys(labels))})")
            activity.call("a communication step")
            return calls

    def open_fmu(component: Component) -> Slave:
        if component.source is None:
            raise Problem(f"{component.name}: expected an FMU file, got none")
        source = str(component.source)
        label = f"{component.name}: {(originals or {}).get(source, source)}"
        labels.append(label)

        def record(call: str, t: float) -> None:
            activity.inputs(f"({label})")
            activity.call(call, t)

        return RecordedFmu(component.name, component.interface, component.source, component.start, record)

    return open_fmu
