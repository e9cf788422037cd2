"""Diagnosis of a machine: its functions, and what they have in common.

**Return line**, P_t = P_0 + R Q with the flow Q of all chambers that are emptied: R in part of the filter,
unless the oil is cold, as a clogging indicator with a thermal lockout; P_0 of a preload, so another one is a
sensor that is wrong.
**Pump**, P_s = P_0 - B Q with the flow Q into all chambers that are filled, at `PUMP_FLOW`; not with
compensated sections, where the pressure follows the load until the pump is at its largest stroke. A pressure
that is another one is that of a wrong sensor if all valves say so. **Lag of all valves**, **air**: the mean
of those of the functions. **Weighing**: weight.py.

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
from fmus.contract import Quantity, Scalar, Subsystem, make_group, quantities, symbols, unknown
from fmus.controller.arm import Arm
from fmus.controller.gains import gains
from fmus.diagnosis import losses, unknowns, valves, weight
from fmus.diagnosis.estimates import FEWEST, SAMPLING, Fit, States, Told, either, judged, shown, whether
from fmus.diagnosis.readings import PRESSURE, Axis, outside
from fmus.diagnosis.unknowns import LINES, LITRE, Unknown, reference, signals_of
from fmus.parameters import Number

FLOW, BAR = 100 * LITRE, 1e5  # scales of the lines
LAG = 0.3  # s, of flows and pressures of the lines: a pump needs as long to follow
PUMP_FLOW = 60 * LITRE  # m3/s, at which the pump is told
PUMP_MEMORY = 600.0  # s: a pump wears over months, its pressure changes from stroke to stroke
WORKING = 10 * LITRE  # m3/s, from which the lines are told
SUPPLY_OFF = 5e5  # Pa, from which a supply pressure is another one
LASTING = 10.0  # s, of strokes, for which it is one: a pump that is short of flow recovers
FLOWLESS = 5.0  # s, without flow, for which a return pressure is one
NARROW = 0.1  # of the drop over an edge, which is left of it at least
COMPARED = 100.0  # s, in which valves show whether it is that of a wrong sensor
# s, 1: what the lag of a valve is off by the manner of its operator, and the air of a function
DELAY_OFF, AIR_OFF = 2.5e-3, 3e-3


@dataclass(frozen=True)
class Diagnosis:
    """The functions of the subsystem for an arm."""

    arm: Arm
    efforts: weight.OfReadings
    tare: Mapping[str, Unknown]

    def work(self, x: Any, u: Any, p: Any) -> tuple[States, dict[str, Told], tuple[Scalar, Scalar]]:
        """States with their rates, what is told of each unknown, and the payload."""
        m, told = States(x, u.reset), dict[str, Told]()
        wrong = self._lines(m, u, p, told)
        q = self.arm.coordinates(u)
        pistons, radial = self.arm.pistons(q, p), [0, *(r for r, _ in self.arm.columns(q, p))]
        driven = self.arm.actuators([at for at, _ in pistons], p)
        rows = zip(self.arm.axes, pistons, radial, strict=True)
        axes = [Axis(a, driven[a.name], (*at, r), replace(m, of=a.name), u, p) for a, at, r in rows]
        speeds = 1 - either(*(a.faulty[1] for a in axes))
        margin = ca.mmin(ca.vertcat(*(a.least_drop for a in axes)))
        for a in axes:
            a.completed(1 - wrong, speeds, margin)
            checks = a.sensors(), losses.leaks(a), losses.balance(a), valves.valve(a)
            for n, one in (row for check in checks for row in check.items()):
                told[n if n.endswith("_sensor") else f"{a.axis.name}_{n}"] = one
        self._pressures(m, axes, u, p, told)
        compensated = either(*(a.compensated for a in axes))
        delay, off, healthy, count = self._together("valve_delay", told, p, DELAY_OFF)
        state = judged(delay - healthy, off, p.delay_limit * (1 + compensated), whether(count > 0))
        told["valve_delay"] = delay - healthy, off, state
        air, off, healthy, count = self._together("air", told, p, AIR_OFF)
        more = air - ca.fmax(healthy, 0)
        told["oil_air"] = more, off, judged(more, off, losses.air_limit(healthy, p), whether(count > 0))
        hot = ca.if_else(u.oil_temperature > 0, whether(u.oil_temperature > p.temperature_limit), -1)
        hot = m.lag("hot", hot, SAMPLING, "1: the oil is too hot, -1: it has no temperature")
        told["oil_temperature_high"] = shown(ca.fmax(hot, 0), hot + 1)
        balances = [weight.balance(a, e) for a in axes if (e := self.efforts(u).get(a.axis.name))]
        slewing = next((a.readings[0] for a in axes if a.axis.turns), 0)
        payload, of_load = weight.weighed(balances, slewing, self.tare, m, p)
        return m, told | of_load, payload

    def _lines(self, m: States, u: Any, p: Any, told: dict[str, Told]) -> Scalar:
        """1: a reading of a line is not to be used."""
        wrong: Scalar = 0
        for n in LINES:
            known, out = getattr(p, f"{n}_fitted"), outside(getattr(u, n), p)
            bad = m.state(f"{n}_bad", f"1: the reading of {n} is wrong")
            m.latch(f"{n}_bad", bad, out * known)
            wrong, told[f"{n}_sensor"] = either(wrong, out, bad, 1 - known), shown(bad, known)
        return wrong

    def _pressures(self, m: States, axes: list[Axis], u: Any, p: Any, told: dict[str, Told]) -> None:
        """Of the lines over their flows."""
        cold = whether(u.oil_temperature > 0) * whether(u.oil_temperature < p.filter_temperature)  # 0: open
        cold = m.lag("cold", cold, SAMPLING, "1: the oil is too cold for the return filter")
        constant = 1 - either(*(a.compensated for a in axes))  # the pump does not follow the load
        known, learned = reference("return_resistance", p) * FLOW / BAR, reference("pump_pressure", p)
        sound = ca.mmin(ca.vertcat(*(a.sound for a in axes)))
        fits, late = dict[str, Fit](), dict[str, tuple[Scalar, Scalar]]()
        for n, way, counts, memory, priors, least, rough in (
            ("tank", -1, 1, valves.SLOW_MEMORY, ((10, known), (10, 4.0)), 0.1, 0.5),
            ("supply", 1, constant, PUMP_MEMORY, ((100, 0), (1000, learned / BAR)), 0.3, 3.0),
        ):
            flow = sum(ca.fmax(way * f, 0) for a in axes for f in a.flows)
            flow = m.lag(f"late_{n}_flow", flow, LAG, f"Flow of the {n} line", "m3/s", True)
            pressure = m.lag(f"late_{n}", getattr(u, f"{n}_pressure"), LAG, f"Pressure of the {n} line", "Pa")
            least = ca.fmax(least, p.pressure_resolution / BAR)  # what is rounded has errors that last
            fits[n], late[n] = Fit(m, n, priors, least, rough), (flow, pressure)
            counts *= sound * whether(flow > WORKING)
            fits[n].adds(counts / LAG, [([flow / FLOW, 1], pressure / BAR)], memory)
        size, off = (BAR / FLOW * v for v in fits["tank"].sizes[0])
        enough = whether(fits["tank"].samples > FEWEST)
        state = judged(size - known * BAR / FLOW, off, p.return_limit, enough * (1 - cold))
        told["return_resistance"] = size, off, state
        usual, (level, off) = reference("return_pressure", p), (BAR * v for v in fits["tank"].sizes[1])
        flow, pressure = late["tank"]
        time = m.state("return_other", "Time without flow for which the return pressure is another one", "s")
        runs = sound * whether(flow < WORKING) * whether(u.supply_pressure > losses.STOPPED)
        other = whether(ca.fabs(pressure - usual) > p.zero_limit) * whether(ca.fabs(usual) > 0)
        m.moves("return_other", runs * (other - (1 - other) * time / SAMPLING))
        told["return_pressure"] = level, off, ca.if_else(time > FLOWLESS, 1, enough - 1)
        size, off = (BAR * v for v in fits["supply"].along(PUMP_FLOW / FLOW, 1))
        enough = whether(fits["supply"].samples > 3 * FEWEST) * whether(learned > 0)
        told["pump_pressure"] = size, off, judged(learned - size, off, p.pump_limit, enough)
        usual = fits["supply"].along(late["supply"][0] / FLOW, 1)[0]
        change = late["supply"][1] - BAR * usual + size - learned
        change *= whether(learned > 0) * whether(fits["supply"].samples > FEWEST)
        self._other_supply(m, axes, change, told)

    def _other_supply(self, m: States, axes: list[Axis], change: Scalar, told: dict[str, Told]) -> None:
        """A supply pressure that is another one [Pa] is that of a wrong sensor if valves seem to be others.

        What they need more of their command than before is explained by the change or not: the limit is half.
        As long as it is another one the maps of valves are not told. The pump is, but not at once: until
        then strokes have shown what valves say.
        """
        counts = whether(ca.fabs(change) > SUPPLY_OFF)
        time = m.sum("supply_other", "Time for which the supply pressure is another one", 1, counts)
        other = whether(time > 0)
        fit = Fit(m, "supply_error", [(1, 0)], valves.ROUGH, 2 * valves.ROUGH)
        rows, count = list[tuple[list[Scalar], Scalar]](), 0
        for counted, opened, nearness, right in (a.compared for a in axes):
            explained = opened * (1 - 1 / ca.sqrt(ca.fmax(1 - change / PRESSURE * nearness, NARROW)))
            rows.append(([ca.sqrt(counted) * explained], ca.sqrt(counted) * right))
            count += counted
        fit.adds(other / valves.WINDOW, rows, valves.SLOW_MEMORY, count)
        ((share, off),) = fit.sizes
        wrong = ca.fmax(judged(share, off, 0.5, whether(fit.samples > FEWEST)), 0) * whether(time > LASTING)
        hidden = {f"{a.axis.name}_{n}": other for a in axes for n in unknowns.MAP[:4]}
        hidden["pump_pressure"] = either(wrong, other * whether(time < COMPARED))
        for n, hides in hidden.items():
            told[n] = *told[n][:2], ca.if_else(hides > 0, -1, told[n][2])
        size, deviation, state = told["supply_pressure_sensor"]
        told["supply_pressure_sensor"] = ca.fmax(size, wrong), deviation, ca.fmax(state, wrong)

    def _together(self, name: str, told: Mapping[str, Told], p: Any, least: float) -> tuple[Scalar, ...]:
        """Mean of a size of all axes that know it, its deviation, the mean of the references, and how many.

        They count by their deviations, of which `least` is what the model of one axis is off.
        """
        total, healthy, weights, count = 0, 0, 1e-9, 0
        for n in (f"{a.name}_{name}" for a in self.arm.axes):
            if n in told:
                size, off, state = told[n]
                known = 1 - whether(state < 0)
                weight = known / (off**2 + least**2)
                total, healthy = total + weight * size, healthy + weight * reference(n, p)
                weights, count = weights + weight, count + known
        return total / weights, 1 / ca.sqrt(weights), healthy / weights, count


def _parameters(arm: Arm, known: Mapping[str, Number], sizes: Mapping[str, Unknown]) -> tuple[Any, Any]:
    """Group of parameters, and their numbers: sensors there are, sizes of a healthy machine, settings."""
    found, numbers = dict[str, Quantity](), dict(unknowns.NUMBERS)
    for n in (*(n for a in arm.axes for n in signals_of(a)), *LINES):
        text = f"1: there is a reading of {n}, 0: there is none"
        found[f"{n}_fitted"] = Quantity("1", text, minimum=0.0, maximum=1.0, group="Readings")
        numbers[f"{n}_fitted"] = Number(1.0, "1", "assumed", "all sensors of the controller")
    for n, k in sizes.items():
        if k.healthy is not None:
            text, full = f"{k.text}; of the healthy machine", f"{n}_reference"
            found[full] = Quantity(k.unit, text, k.nominal, group="Healthy machine")
            numbers[full] = Number(k.healthy, k.unit, "assumed", "no healthy machine was measured")
    flows = {n: q for n, q in quantities(gains(arm.axes)).items() if n.endswith("_section_flow")}
    nominal = Quantity("Pa", "Supply pressure, above which relief valves may be open", 1e7, group="Supply")
    declared = flows | {"nominal_supply_pressure": nominal} | found
    group = make_group("Parameters", declared, *arm.parameters, oil.Grade, unknowns.Settings)
    own = {n for n, q in quantities(group).items() if n not in numbers and q.value is None}
    return group, numbers | {n: known[n] for n in quantities(group) if n in own}


def _inputs(arm: Arm) -> dict[str, Quantity]:
    """Commands and readings."""
    found = dict[str, Quantity]()
    for a in arm.axes:
        found[f"{a.name}_command"] = Quantity("V", f"Command to the {a.name} valve", 10.0)
        texts = (a.coordinate[1], a.speed[1], a.sides[0][1], a.sides[1][1])
        for (n, unit), text in zip(signals_of(a).items(), texts, strict=True):
            found[n] = Quantity(unit, text, 1e7 if unit == "Pa" else 1.0)
    for (n, text), size in zip(LINES.items(), (1e7, 1e5), strict=True):
        found[n] = Quantity("Pa", text, size)
    optional = "the oil stays at 60 degC"
    found["oil_temperature"] = ports.oil_temperature("Temperature of the oil", optional=optional)
    gap = "1: there are no readings now, or those before are of another time"
    for n, text, without in (
        ("gap", gap, "readings come all the time"),
        ("reset", "1: forget faults", "nothing is forgotten"),
    ):
        found[n] = Quantity("1", text, minimum=0.0, maximum=1.0, optional=without)
    return found


def _outputs(all_unknowns: Mapping[str, Unknown]) -> dict[str, Quantity]:
    """The payload, and of each unknown its size, its deviation, its state."""
    found = {"payload": Quantity("kg", "Payload", 100.0)}
    found["payload_deviation"] = Quantity("kg", "Standard deviation of the payload", 100.0)
    for n, k in all_unknowns.items():
        found[n] = Quantity(k.unit, k.text, k.nominal)
        found[f"{n}_deviation"] = Quantity(k.unit, f"Standard deviation of {n}", k.nominal)
        words = f"; {k.words}" if k.words else ""
        found[f"{n}_state"] = Quantity("1", f"{n}: 1 a fault ({k.repair}), 0 none, -1 cannot be told{words}")
    return found


def diagnosis(arm: Arm, known: Mapping[str, Number], manipulator: Subsystem) -> Subsystem:
    """The diagnosis of a machine.

    known         values of the parameters of its controller
    manipulator   its mechanics, from which the weight of the empty arm follows
    """
    all_unknowns = unknowns.findings(arm, manipulator)
    of = Diagnosis(arm, weight.efforts_of(manipulator, arm.axes), unknowns.tare_of(arm, manipulator))
    parameters, numbers = _parameters(arm, known, all_unknowns)
    inputs, outputs = make_group("Inputs", _inputs(arm)), make_group("Outputs", _outputs(all_unknowns))
    declared, _, _ = of.work(None, symbols(inputs), symbols(parameters))
    states = make_group("States", declared.declared)

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        return states(**of.work(x, u, p)[0].rates)

    def observe(x: Any, _: Any, p: Any) -> Any:
        _, told, (payload, deviation) = of.work(x, unknown(inputs), p)
        found = {"payload": payload, "payload_deviation": deviation}
        for n, row in told.items():
            found |= {f"{n}{end}": v for end, v in zip(("", "_deviation", "_state"), row, strict=True)}
        return outputs(**found)

    sub = Subsystem(
        name="diagnosis",
        text="Diagnosis: leaks, bursts, valves, sensors, lines, air and payload, with their deviations",
        parameters=parameters,
        states=states,
        inputs=inputs,
        outputs=outputs,
        dynamics=dynamics,
        observe=observe,
        derive=arm.derive,
        initial=lambda _, u, p: of.work(None, u, p)[0].starts,
        numbers={"parameters": numbers, "start": {}},
        stiff=False,
        sampling=SAMPLING,
        validity="readings every 10 ms or faster; leaks that act at rest",
    )
    return replace(oil.at_temperature(sub), observe=observe)
