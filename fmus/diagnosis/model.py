"""Diagnosis of a machine: the checks of its functions, and what the functions have in common.

**Return line**, P_t = P_0 + R Q with the flow Q of all chambers that are emptied, in part the filter; unless
the oil is cold, as a clogging indicator with a thermal lockout.
**Pump**, P_s = P_0 - B Q with the flow Q into all chambers that are filled, at `PUMP_FLOW`; not with
compensated sections, where the pressure follows the load until the pump is at its largest stroke. A pressure
that is another one, while the valves of several functions seem to be, is that of a wrong sensor. **Lag of
all valves**: the mean of those of the functions. **Weighing**: weight.py.

It is sampled, as a control unit, and its outputs depend on its states alone. Signs: those of the controller.

Validity: readings every 10 ms or faster. On level ground both lines of a motor at rest have one pressure, so
its seals do not show. A hose in front of counterbalance valves does not show at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components import oil
from fmus.contract import Quantity, Scalar, Subsystem, make_group, quantities, unknown
from fmus.controller.arm import Arm, ControlledAxis
from fmus.controller.gains import gains
from fmus.diagnosis import leaks, sensors, valves, weight
from fmus.diagnosis.axis import Axis, Efforts, Finding, outside, shared_states, signals_of
from fmus.diagnosis.estimates import (
    FEWEST,
    QUICK,
    SAMPLING,
    Fit,
    Prior,
    Solution,
    Told,
    counted,
    either,
    judged,
    latched,
    shown,
    whether,
)
from fmus.diagnosis.settings import LITRE, NUMBERS, OF_MACHINE, OF_VALVE, REFERENCES, Settings, number
from fmus.parameters import Number

NAME = "diagnosis"
LINES = {
    "supply_pressure": ("Pressure of the supply line", 1e7),
    "tank_pressure": ("Pressure of the return line", 1e5),
}
FLOW, BAR = 100 * LITRE, 1e5  # scales of the lines
PUMP_FLOW = 60 * LITRE  # m3/s, at which the pump is told
WORKING = 10 * LITRE  # m3/s, from which the lines are told
SUPPLY_OFF = 5e5  # Pa, from which a supply pressure is another one
COMPARED = 100.0  # s, in which valves show whether it is that of a wrong sensor
DELAY_OFF, AIR_OFF = 1e-6, 3e-3  # s, 1: what the lag of a valve or the air of a function is off
RETURN, PUMP = Fit("return", ("flow", "one")), Fit("pump", ("flow", "one"))
ALONE = {
    "return_resistance": Finding("Pa.s/m3", "Resistance of the return line", 1e7, "return filter"),
    "pump_pressure": Finding("Pa", "Supply pressure at 60 L/min, unless it follows the load", 1e6, "pump"),
    "valve_delay": Finding(
        "s", "Lag of all valves more than that of the healthy machine", 0.01, "pilot filter"
    ),
    "oil_air": Finding("1", "Undissolved air in the oil more than that of the healthy machine", 0.01, "air"),
    "oil_temperature_high": Finding("1", "1: the oil is hotter than its limit", 1.0, "cooler"),
    "weighing": Finding("N", "Mean horizontal force at the tip", 100.0, "pressure sensors"),
}


CHECKS, FITTING = (leaks, valves, sensors), (leaks, valves)


def _of_pump(x: Any, p: Any) -> Solution:
    """Its pressure over its flow."""
    return PUMP.solved(x, Prior((100, 1000), (0, number("pump_pressure", p) / BAR), 0.3, 3.0))


def _full(axis: ControlledAxis, name: str) -> str:
    """Of a finding; those of sensors have the name of the axis."""
    return name if name.endswith("_sensor") else f"{axis.name}_{name}"


def _findings_of(axis: ControlledAxis) -> dict[str, Finding]:
    """Of all checks of an axis."""
    found = {n: f for check in CHECKS for n, f in check.findings(axis).items()}
    return {
        _full(axis, n): replace(f, text=f.text.format(axis.name), repair=f.repair.format(axis.name))
        for n, f in found.items()
    }


def _states_of(axis: ControlledAxis, tare: weight.Tare) -> dict[str, Quantity]:
    """Of all checks of an axis, with their sums."""
    found = shared_states(axis) | tare.states(axis)
    for check in (*CHECKS, weight):
        found |= check.states(axis)
    sums = (n for check in FITTING for fit in check.fits(axis).values() for n in fit.states)
    found |= {n: Quantity("1", f"Sum of normal equations: {n}, {axis.name}") for n in sums}
    return {f"{axis.name}_{n}": q for n, q in found.items()}


@dataclass(frozen=True)
class Diagnosis:
    """The functions of the subsystem for an arm."""

    arm: Arm
    efforts: weight.OfReadings
    tare: weight.Tare
    inputs: type[Any]
    states: type[Any]
    outputs: type[Any]

    def _axes(self, x: Any, u: Any, p: Any, efforts: Mapping[str, Efforts] | None = None) -> list[Axis]:
        """efforts: by axis, of what depends on readings."""
        pistons = self.arm.pistons(self.arm.coordinates(u), p)
        driven, lines = (
            self.arm.actuators([at for at, _ in pistons], p),
            1 - either(*self._wrong(x, u, p).values()),
        )
        radial = [0, *(r for r, _ in self.arm.columns(self.arm.coordinates(u), p))]
        axes = [
            Axis(a, driven[a.name], at, lever, x, u, p, lines, 1, (efforts or {}).get(a.name, {}), r)
            for a, (at, lever), r in zip(self.arm.axes, pistons, radial, strict=True)
        ]
        speeds = 1 - either(*(a.faulty[1] for a in axes))
        margin = ca.mmin(ca.vertcat(*(a.least_drop for a in axes)))
        return [replace(a, speeds=speeds, margin=margin) for a in axes]

    def _wrong(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """1: the reading of a line is not to be used."""
        return {
            n: either(outside(getattr(u, n), p), getattr(x, f"{n}_bad"), 1 - getattr(p, f"{n}_fitted"))
            for n in LINES
        }

    def dynamics(self, x: Any, u: Any, p: Any) -> Any:
        """Filters, clocks, latches and sums."""
        rates, axes, sound = dict[str, Scalar](), self._axes(x, u, p, self.efforts(u)), 1
        for a in axes:
            checked = (rate for check in (*CHECKS, weight) for rate in check.rates(a).items())
            own = a.rates() | dict(checked)
            rates |= {f"{a.axis.name}_{n}": rate for n, rate in own.items()}
            sound *= a.sound
        for n in LINES:
            wrong = outside(getattr(u, n), p) * getattr(p, f"{n}_fitted")
            rates[f"{n}_bad"] = latched(getattr(x, f"{n}_bad"), wrong, u.reset)
        flows = [f for a in axes for f in a.flows]
        inward, outward = (sum(ca.fmax(sign * f, 0) for f in flows) for sign in (1, -1))
        late = {"inward": inward, "outward": outward, "supply": u.supply_pressure, "tank": u.tank_pressure}
        rates |= {f"late_{n}": (now - getattr(x, f"late_{n}")) / p.window for n, now in late.items()}
        constant = 1 - either(*(a.compensated for a in axes))  # the pump does not follow the load
        cold = whether(u.oil_temperature > 0) * whether(u.oil_temperature < p.filter_temperature)  # 0: open
        for fit, flow, pressure, counts, memory in (
            (RETURN, x.late_outward, x.late_tank, 1 - cold, p.slow_memory),
            (PUMP, x.late_inward, x.late_supply, constant, p.pump_memory),
        ):
            counts *= sound * whether(flow > WORKING) / p.window
            rates |= fit.rates(x, counts, [([flow / FLOW, 1], pressure / BAR)], memory)
        arm, slewing = ([a for a in axes if a.axis.turns == turns] for turns in (False, True))
        load = weight.Load(arm, x, p, slewing)
        rates["supply_other"] = counted(x.supply_other, self._other_supply(x, p))
        rates |= load.rates() | self.tare.rates(load)
        rates["hot"] = (whether(u.oil_temperature > p.temperature_limit) - x.hot) / QUICK
        return self.states(**rates)

    def observe(self, x: Any, _: Any, p: Any) -> Any:
        """Findings and payload."""
        told, axes = dict[str, Told](), self._axes(x, unknown(self.inputs), p)
        for a in axes:
            told |= {_full(a.axis, n): t for check in CHECKS for n, t in check.told(a).items()}
        told |= {f"{n}_sensor": shown(getattr(x, f"{n}_bad"), getattr(p, f"{n}_fitted")) for n in LINES}
        told["return_resistance"] = self._return(x, p)
        told["pump_pressure"] = self._pump(x, p)
        self._supply(told, x)
        told["valve_delay"], told["oil_air"] = self._delay(told, axes, p), self._air(told, p)
        told["oil_temperature_high"] = shown(x.hot)
        load = weight.Load((), x, p)
        payload, told["weighing"] = load.payload(), load.weighing()
        told |= self.tare.told(x, p)
        found = {"payload": payload[0], "payload_deviation": payload[1]}
        for n, (size, deviation, state) in told.items():
            found |= {n: size, f"{n}_deviation": deviation, f"{n}_state": state}
        return self.outputs(**found)

    def _return(self, x: Any, p: Any) -> Told:
        scale, known = BAR / FLOW, number("return_resistance", p)
        fitted = RETURN.solved(x, Prior((10, 10), (known / scale, 4.0), 0.1, 0.5))
        (size, off), _ = ((scale * s, scale * d) for s, d in fitted)
        return size, off, judged(size - known, off, p.return_limit, whether(fitted.samples > FEWEST))

    def _pump(self, x: Any, p: Any) -> Told:
        known, fitted = number("pump_pressure", p), _of_pump(x, p)
        size, off = (BAR * v for v in fitted.along(PUMP_FLOW / FLOW, 1))
        told = whether(fitted.samples > 3 * FEWEST) * whether(known > 0)  # 0: no healthy machine was measured
        return size, off, judged(known - size, off, p.pump_limit, told)

    def _other_supply(self, x: Any, p: Any) -> Scalar:
        """1: the supply pressure is not the one of before, nor of the healthy machine."""
        known, fitted = number("pump_pressure", p), _of_pump(x, p)
        usual, _ = fitted.along(x.late_inward / FLOW, 1)
        mean, _ = fitted.along(PUMP_FLOW / FLOW, 1)
        off = ca.fmax(ca.fabs(x.late_supply - BAR * usual), ca.fabs(BAR * mean - known))
        return whether(off > SUPPLY_OFF) * whether(known > 0) * whether(fitted.samples > FEWEST)

    def _supply(self, told: dict[str, Told], x: Any) -> None:
        """A supply pressure that is another one, by which several valves seem to be others, is wrong.

        As long as it is another one the maps of valves are not told. The pump is, but not at once: until then
        strokes have shown whether valves seem to be others.
        """
        other = whether(x.supply_other > 0)
        maps = {a.name: [f"{a.name}_{n}" for n in OF_VALVE[:4]] for a in self.arm.axes}
        count = sum(either(*(whether(told[n][2] > 0) for n in names)) for names in maps.values())
        wrong = other * whether(count > 1)
        hidden = {n: other for names in maps.values() for n in names}
        hidden["pump_pressure"] = either(wrong, other * whether(x.supply_other < COMPARED))
        for n, hides in hidden.items():
            size, deviation, state = told[n]
            told[n] = size, deviation, ca.if_else(hides > 0, -1, state)
        size, deviation, state = told["supply_pressure_sensor"]
        told["supply_pressure_sensor"] = ca.fmax(size, wrong), deviation, ca.fmax(state, wrong)

    def _together(self, name: str, told: Mapping[str, Told], p: Any, least: float) -> tuple[Scalar, ...]:
        """Mean of a size of all axes that know it, its deviation, the mean of the references, and how many.

        They count by their deviations, of which `least` is what the model of one axis is off.
        """
        total, healthy, weights, count = 0, 0, 1e-9, 0
        for a in self.arm.axes:
            if f"{a.name}_{name}" not in told:
                continue
            size, off, state = told[f"{a.name}_{name}"]
            known = 1 - whether(state < 0)
            weight = known / (off**2 + least**2)
            reference = number(f"{a.name}_{name}", p)
            total, healthy = total + weight * size, healthy + weight * reference
            weights, count = weights + weight, count + known
        return total / weights, 1 / ca.sqrt(weights), healthy / weights, count

    def _delay(self, told: Mapping[str, Told], axes: list[Axis], p: Any) -> Told:
        size, off, healthy, count = self._together("valve_delay", told, p, DELAY_OFF)
        limit = p.delay_limit * (1 + either(*(a.compensated for a in axes)))
        return size - healthy, off, judged(size - healthy, off, limit, whether(count > 0))

    def _air(self, told: Mapping[str, Told], p: Any) -> Told:
        size, off, healthy, count = self._together(leaks.AIR, told, p, AIR_OFF)
        more = size - ca.fmax(healthy, 0)
        return more, off, judged(more, off, leaks.air_limit(healthy, p), whether(count > 0))

    def initial(self, _: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Filters at the readings; sums of nothing."""
        start: dict[str, Scalar] = {
            "late_supply": u.supply_pressure,
            "late_tank": u.tank_pressure,
            "horizontal_square": weight.SWINGING**2,
        }
        for a in self._axes(unknown(self.states), u, p, self.efforts(u)):
            own = {f"late_{k}": a.reading(k) for k in range(4)} | {
                "late_command": a.command,
                "trailing": a.command,
            }
            own |= weight.start(a)
            start |= {f"{a.axis.name}_{n}": now for n, now in own.items()}
        return start


def findings(arm: Arm, manipulator: Subsystem) -> dict[str, Finding]:
    """All, in the order of the outputs."""
    found = {n: f for a in arm.axes for n, f in _findings_of(a).items()}
    lines = {
        f"{n}_sensor": Finding("1", f"1: the reading of {n} is wrong", 1.0, f"{n} sensor") for n in LINES
    }
    return found | lines | ALONE | weight.Tare.of(arm, manipulator).findings


def _own_parameters(
    arm: Arm, names: Mapping[str, Finding], tare: weight.Tare
) -> dict[str, tuple[Quantity, Number]]:
    """Sensors that a machine has, and references of a healthy one."""
    found = dict[str, tuple[Quantity, Number]]()
    for n in (*(n for a in arm.axes for n in signals_of(a)), *LINES):
        text = f"1: there is a reading of {n}, 0: there is none"
        quantity = Quantity("1", text, minimum=0.0, maximum=1.0, group="Readings")
        found[f"{n}_fitted"] = quantity, Number(1.0, "1", "assumed", "all sensors of the controller")
    healthy = {f"{a.name}_{n}": value for a in arm.axes for n, value in REFERENCES.items()} | OF_MACHINE
    healthy |= tare.references
    for n, value in healthy.items():
        if n in names:
            f, note = names[n], "no healthy machine was measured"
            quantity = Quantity(
                f.unit, f"{f.text}; of the healthy machine", f.nominal, group="Healthy machine"
            )
            found[f"{n}_reference"] = quantity, Number(value, f.unit, "assumed", note)
    return found


def diagnosis(arm: Arm, known: Mapping[str, Number], manipulator: Subsystem) -> Subsystem:
    """The diagnosis of a machine.

    known         values of the parameters of its controller
    manipulator   its mechanics, from which the weight of the empty arm follows
    """
    inputs, states, outputs = dict[str, Quantity](), dict[str, Quantity](), dict[str, Quantity]()
    all_findings, tare = findings(arm, manipulator), weight.Tare.of(arm, manipulator)
    for a in arm.axes:
        inputs[f"{a.name}_command"] = Quantity("V", f"Command to the {a.name} valve", 10.0)
        texts = (a.coordinate[1], a.speed[1], a.sides[0][1], a.sides[1][1])
        for n, unit, text in zip(signals_of(a), (*a.units, "Pa", "Pa"), texts, strict=True):
            inputs[n] = Quantity(unit, text, 1e7 if unit == "Pa" else 1.0)
        states |= _states_of(a, tare)
    for n, (text, size) in LINES.items():
        inputs[n] = Quantity("Pa", text, size)
        states[f"{n}_bad"] = Quantity("1", f"1: the reading of {n} is wrong")
    inputs["oil_temperature"] = ports.oil_temperature(
        "Temperature of the oil", optional="the oil stays at 60 degC"
    )
    inputs["gap"] = Quantity(
        "1",
        "1: there are no readings now, or those before are of another time",
        minimum=0.0,
        maximum=1.0,
        optional="readings come all the time",
    )
    inputs["reset"] = Quantity(
        "1", "1: forget faults", minimum=0.0, maximum=1.0, optional="nothing is forgotten"
    )
    for n, unit, text in (
        ("inward", "m3/s", "Flow into all chambers"),
        ("outward", "m3/s", "Flow out of all chambers"),
        ("supply", "Pa", "Supply pressure"),
        ("tank", "Pa", "Pressure of the return line"),
    ):
        states[f"late_{n}"] = Quantity(
            unit, f"{text}, behind the slow lag", {"Pa": 1e7, "m3/s": 1e-3}.get(unit, 1.0)
        )
    states |= weight.Load.states()
    states["supply_other"] = Quantity("s", "Time for which the supply pressure is another one than before")
    states["hot"] = Quantity("1", "1: the oil is hotter than its limit")
    states |= {
        n: Quantity("1", f"Sum of normal equations: {n}")
        for fit in (RETURN, PUMP, weight.PAYLOAD, weight.WEIGHING, tare.fit)
        for n in fit.states
    }
    outputs["payload"] = Quantity("kg", "Payload", 100.0)
    outputs["payload_deviation"] = Quantity("kg", "Standard deviation of the payload", 100.0)
    for n, f in all_findings.items():
        outputs[n] = Quantity(f.unit, f.text, f.nominal)
        outputs[f"{n}_deviation"] = Quantity(f.unit, f"Standard deviation of {n}", f.nominal)
        outputs[f"{n}_state"] = Quantity("1", f"{n}: 1 a fault ({f.repair}), 0 none, -1 cannot be told")
    own = _own_parameters(arm, all_findings, tare)
    flows = {n: q for n, q in quantities(gains(arm.axes)).items() if n.endswith("_section_flow")}
    nominal = Quantity("Pa", "Supply pressure, above which relief valves may be open", 1e7, group="Supply")
    declared = flows | {"nominal_supply_pressure": nominal} | {n: q for n, (q, _) in own.items()}
    parameters = make_group("Parameters", declared, *arm.parameters, oil.Grade, Settings)
    numbers = NUMBERS | {n: value for n, (_, value) in own.items()}
    grade = quantities(oil.Grade)
    numbers |= {
        n: Number(q.value, q.unit, "assumed", "VG 46") for n, q in grade.items() if q.value is not None
    }
    numbers |= {n: known[n] for n in quantities(parameters) if n not in numbers}
    of = Diagnosis(
        arm,
        weight.efforts_of(manipulator, arm.axes),
        tare,
        make_group("Inputs", inputs),
        make_group("States", states),
        make_group("Outputs", outputs),
    )
    sub = Subsystem(
        name=NAME,
        text="Diagnosis: leaks, bursts, valves, sensors, lines, air and payload, with their deviations",
        parameters=parameters,
        states=of.states,
        inputs=of.inputs,
        outputs=of.outputs,
        dynamics=of.dynamics,
        observe=of.observe,
        derive=arm.derive,
        initial=of.initial,
        numbers={"parameters": numbers, "start": {}},
        stiff=False,
        sampling=SAMPLING,
        validity="readings every 10 ms or faster; leaks that act at rest",
    )
    return replace(oil.at_temperature(sub), observe=of.observe)
