"""A controller as a machine has it: sampled, late by a sample, with encoders and noisy pressures.

It stands where the FMU of the controller stands (`run(..., open=opener(...))`): every `period` steps of the
master it reads its inputs and computes one step of that length; its commands come out when that is over.
"""

from collections.abc import Sequence

import numpy as np

from orchestrator.engine.run import open_slave
from orchestrator.fmi.calls import Buffer, Call, Slave
from orchestrator.fmi.cosimulation import CoSimulationFmu
from orchestrator.ssp.system import Component

COUNT = 2 * np.pi / 65536  # rad, of an encoder
NOISE = 1e4  # Pa, standard deviation of a pressure


class Sampled(CoSimulationFmu):
    """The controller's FMU behind its sensors."""

    period = 10  # steps of the master
    done = 0
    live = False
    stepping = None  # type: ignore[assignment]  # Python steps it

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """The last sample may end after the run."""
        super().setup(start, stop + 1.0, tolerance)
        self.noise = np.random.default_rng(1)

    def exit(self) -> None:
        super().exit()
        self.live = True

    @property
    def due(self) -> bool:
        """Is it time to look at the inputs and to let the commands out?"""
        return not self.live or self.done % self.period == 0

    def writer(self, variables: Sequence[str], values: Buffer) -> Call:
        """Angles in counts, pressures with noise."""
        seen = np.array(values, float)
        write = super().writer(variables, seen)
        angles = np.array([n in ("swing_angle", "boom_angle", "stick_angle") for n in variables])
        pressures = np.array(["pressure" in n for n in variables])

        def sample() -> None:
            if self.due:
                seen[:] = np.where(angles, np.round(values / COUNT) * COUNT, values)
                seen[:] += NOISE * pressures * self.noise.normal(size=seen.size)
                write()

        return sample

    def reader(self, variables: Sequence[str], into: Buffer) -> Call:
        """Commands stand still between two samples: their rates are zero."""
        out = np.zeros(len(variables))
        read = super().reader(variables, out)
        still = np.array([n.endswith("_rate") for n in variables])

        def give() -> None:
            if self.due:
                read()
            into[:] = np.where(still & self.live, 0.0, out)

        return give

    def input_degree(self, *_: object) -> int:
        """Inputs are held."""
        return 0

    def outputs_with_derivatives(self, *_: object) -> Sequence[str]:
        """No slopes of outputs."""
        return []

    def step(self, t: float, h: float) -> None:
        if self.due:
            super().step(t, self.period * h)
        self.done += 1


def opener(component: Component, kind: type[Sampled] = Sampled) -> Slave:
    """For `run`: the controller behind sensors, all others as they are."""
    if component.name != "controller":
        return open_slave(component)
    assert component.source is not None
    return kind(component.name, component.interface, component.source, component.start)
