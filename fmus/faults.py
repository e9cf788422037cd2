"""Faults of a machine as inputs of its FMUs: 0 is healthy, and a size may change during a run.

An input changes a parameter that exists, such as the pressure of a relief valve, or one of a component that
only a machine with faults has: openings to the outside, leakage past seals (`fmus.components.additions`),
condition of a valve (`fmus.valve_actuation`). Leaks are branches of the circuit, so energy and oil close.

At 0 the equations are those of the healthy machine. The stored energy, for example of oil with more air,
jumps when a size jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from fmus.components.additions import CylinderLeaks, MotorLeaks, PistonLeakage
from fmus.contract import Quantity, Scalar, Subsystem, flat, make_group, nested, quantities
from fmus.drives.drive import Additions

Change = Callable[[Scalar, Scalar], Scalar]  # (value of the parameter, size of the fault) -> value


@dataclass(frozen=True)
class Fault:
    """A fault of a part.

    unit, text, nominal   of the input
    changes               parameter -> its value with the fault; the part has one of them at least
    most                  largest size
    """

    unit: str
    text: str
    nominal: float
    changes: Mapping[str, Change]
    most: float | None = None

    def of(self, name: str) -> Fault:
        """With the name of an axis or a part in place of "{}"."""
        return replace(
            self, text=self.text.format(name), changes={n.format(name): c for n, c in self.changes.items()}
        )


def _more(value: Scalar, size: Scalar) -> Scalar:
    return value + size


def _less(value: Scalar, size: Scalar) -> Scalar:
    return value * (1 - size)


def _slower(value: Scalar, size: Scalar) -> Scalar:
    return value / (1 + size)


def _longer(value: Scalar, size: Scalar) -> Scalar:
    return value * (1 + size)


def _leakier(resistance: Scalar, size: Scalar) -> Scalar:
    return resistance / (1 + size * resistance)


def _loss(text: str, *parameters: str, most: float = 1.0) -> Fault:
    return Fault("1", f"Fraction that is lost of {text}", 0.1, dict.fromkeys(parameters, _less), most)


def _leak(side: str, *parameters: str) -> Fault:
    text = f"Opening to the outside at {side} of the {{}}; 1e-7: drips, 5e-5: burst"
    return Fault("m2", text, 1e-6, dict.fromkeys(parameters, _more))


SEAL, LEAK = "seal", "leak"  # additions
LEVER = "_lever"  # end of the names of terminals of axes and valves
CYLINDER_ADDITIONS: Additions = ((SEAL, PistonLeakage), (LEAK, CylinderLeaks))
MOTOR_ADDITIONS: Additions = ((LEAK, MotorLeaks),)
# of an axis, "{}" is its name; parameters of the swing have no name in front
OF_AXIS = {
    "{}_seal_leakage": Fault(
        "m3/(s.Pa)",
        "Leakage past the seals of the {} in addition",
        1e-12,
        {
            "{}_seal_conductance": _more,
            "{}_internal_leakage_resistance": _leakier,
            "internal_leakage_resistance": _leakier,
        },
    ),
    "{}_head_leak": _leak("the head side", "{}_leak_head_pressure"),
    "{}_rod_leak": _leak("the rod side", "{}_leak_rod_pressure"),
    "{}_leak_a": _leak("line A", "{}_leak_pressure_a", "leak_pressure_a"),
    "{}_leak_b": _leak("line B", "{}_leak_pressure_b", "leak_pressure_b"),
    "{}_brake_loss": _loss(
        "the torque of the {} brake", "{}_brake_holding_torque", "brake_torque", most=0.99
    ),
    "{}_spool_stuck": Fault("1", "1: the {} spool is stuck", 1.0, {"{}_stuck": _more}, 1.0),
    "{}_driver_loss": Fault(
        "1",
        "Fraction of the {} command that does not arrive; 1: no current",
        1.0,
        {"{}_loss": _more},
        1.0,
    ),
    "{}_hysteresis_added": Fault(
        "1", "Hysteresis of the {} valve in addition", 0.01, {"{}_more_hysteresis": _more}, 0.5
    ),
}
# of a part, "{}" is its name
OF_PART = {
    "{}_air": Fault(
        "1", "Share of undissolved air in the oil of {} in addition", 0.01, {"air_share": _more}, 0.2
    ),
    "{}_relief_loss": _loss(
        "the setting of the relief valves of {}", "relief_pressure", "port_relief_pressure"
    ),
    "{}_counterbalance_loss": _loss(
        "the setting of the counterbalance valves of {}", "counterbalance_pressure"
    ),
    "pump_wear": Fault(
        "m3/(s.Pa)",
        "Leakage of each pump in addition",
        1e-12,
        {"pump_leakage": _more, "main_pump_leakage": _more},
    ),
    "filter_clogging": Fault(
        "Pa.s/m3", "Resistance of the return filter in addition", 1e8, {"return_resistance": _more}
    ),
    "cooler_loss": _loss("the heat that the cooler takes", "cooler_conductance"),
    "pilot_filter_clogging": Fault(
        "1",
        "Lag and ramp of the spools in addition, in multiples of those without the fault",
        1.0,
        {"lag": _longer, "largest_rate": _slower},
    ),
}


def of(sub: Subsystem) -> dict[str, Fault]:
    """Faults that the parameters of a part allow, by the name of the input."""
    known = quantities(sub.parameters)
    axes = [t.name.removesuffix(LEVER) for t in sub.terminals if t.name.endswith(LEVER)]
    some = [(pattern, axis, fault) for axis in axes for pattern, fault in OF_AXIS.items()]
    some += [(pattern, sub.component, fault) for pattern, fault in OF_PART.items()]
    found = dict[str, Fault]()
    for pattern, name, fault in some:
        own = fault.of(name)
        changes = {n: change for n, change in own.changes.items() if n in known}
        if changes:
            found[pattern.format(name)] = replace(own, changes=changes)
    return found


def faulty(sub: Subsystem) -> Subsystem:
    """A part with its faults as inputs."""
    faults = of(sub)
    if not faults:
        return sub
    declared = {
        n: Quantity(
            f.unit, f"Fault: {f.text}", f.nominal, minimum=0.0, maximum=f.most, optional="the part is healthy"
        )
        for n, f in faults.items()
    }
    inputs = make_group("Inputs", declared, sub.inputs)

    def changed(u: Any, p: Any) -> Any:
        values = flat(p)
        for name, fault in faults.items():
            for parameter, change in fault.changes.items():
                values[parameter] = change(values[parameter], getattr(u, name))
        return nested(sub.parameters, values)

    def at(function: Callable[[Any, Any, Any], Any]) -> Callable[[Any, Any, Any], Any]:
        return lambda x, u, p: function(x, nested(sub.inputs, flat(u)), changed(u, p))

    return replace(
        sub,
        inputs=inputs,
        dynamics=at(sub.dynamics),
        observe=at(sub.observe),
        initial=at(sub.initial),
        # of the healthy part: a fault may change the order of its settings
        require=lambda x, u, p: sub.require(x, nested(sub.inputs, flat(u)), p),
        circuits=at(sub.circuits),
    )
