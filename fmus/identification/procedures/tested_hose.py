"""A hose on a test bench: what is known of it, its friction law, and how it is scaled to the machine's lines.

dp is the friction of the machine (`hose.Friction`): laminar by the viscosity of the oil, above the critical
flow Blasius' law, whose C_R is stated at 170 L/min (correction E10 in docs/equations.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import parameter_value
from fmus.identification.procedures.fit import Quantity
from fmus.identification.procedures.procedure import Parameters, Recordings

AXES = ("boom_stick.stick_hose", "boom_stick.boom_hose")
WIDEST = 3.0  # of the logarithm of a viscosity over the known one, in a search that diverges


@dataclass(frozen=True)
class TestedHose:
    """Size of a tested hose [m], density and viscosity of its oil, the machine's density over that one."""

    length: float
    bore: float
    density: float
    viscosity: float
    to_density: float
    parameters: Parameters

    @classmethod
    def of(cls, tests: Recordings, parameters: Parameters) -> TestedHose:
        """As the recordings state it; an oil that they do not state is the machine's."""
        length, bore = (data.one_size(tests, n) for n in ("length", "diameter"))
        density, viscosity = (
            data.stated(tests[0], n) or parameter_value(parameters, f"boom_stick.{n}")
            for n in ("density", "viscosity")
        )
        to_density = data.density_ratio(tests, parameters)
        return cls(length, bore, density, viscosity, to_density, parameters)

    @property
    def size(self) -> str:
        """For a title."""
        return f"{self.length:g} m, bore {self.bore * 1e3:.4g} mm"

    @property
    def frequency(self) -> float:
        """Of eq. (3), above which it is no single lump [Hz]."""
        modulus = parameter_value(self.parameters, "boom_stick.bulk_modulus")
        return float(hose.frequency_limit(self.length, self.density, modulus))

    @property
    def constants(self) -> tuple[float, ...]:
        """Those of the law."""
        return self.length, self.bore, self.density, self.viscosity

    def scaled(
        self,
        quantity: str,
        unit: str,
        unknown: str,
        lines: Sequence[str],
        factor: Callable[[float, float], float],
        note: str,
        scaling: str,
    ) -> list[Quantity]:
        """A quantity of the machine's lines: `factor` of the ratios of length and bore times the unknown.

        scaling   format of what is added to the note if that is not 1
        """
        found = []
        for line in lines:
            length, bore = (parameter_value(self.parameters, f"{line}_{n}") for n in ("length", "bore"))
            ratio = factor(length / self.length, bore / self.bore)
            about = f"{length:g} m, {bore * 1e3:.4g} mm"
            how = note + (scaling.format(ratio=ratio, size=about, own=self) if abs(ratio - 1) > 1e-9 else "")
            found.append(Quantity(f"{line}_{quantity}", unit, unknown, how, ratio))
        return found

    def remark(self) -> str:
        """What was taken as known."""
        return f"Known: density {self.density:.4g} kg/m3, viscosity {self.viscosity:.4g} Pa.s."


def friction(own: Any, known: Sequence[Any], thicker: Any = 0.0) -> hose.Friction:
    """The friction of a hose with C_R at the known viscosity, in an oil that is exp(thicker) times it.

    known   `TestedHose.constants`
    """
    length, bore, density, viscosity = known
    ratio = ca.exp(ca.fmax(-WIDEST, ca.fmin(thicker, WIDEST)))
    oil = Liquid(density=density, viscosity=viscosity * ratio)
    scaled = hose.scaled_resistance(own, 1, 1, ratio)
    return hose.Friction.of(hose.HoseSize(length=length, bore=bore), scaled, oil)
