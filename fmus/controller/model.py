"""Coordinated control of the tip: from a commanded tip velocity or path to three valve commands.

    reference (reference.py) -> speed of each actuator (actuator.py) -> command (valve.py) -> amplifier
    -> compensation of the play (play.py)

    spool' = (target - spool)/T        target = lever + m (control - lever),  m' = (engaged - m)/T_blend

m is the weight of coordinated control, control the command of the actuator's control law, T `amplifier_time`
and T_blend `blend_time`.

Signs: radius outwards, height upwards, angle counter-clockwise seen from above. Commands have the signs of
the levers: a positive one turns left, raises the boom, extends the stick cylinder (which folds the stick in).
Errors are reference minus machine. Values that the machine has, too, are those of its subsystems.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.boom_stick import BOOM_STICK
from fmus.contract import Scalar, Subsystem, quantities, symbolic
from fmus.controller.actuator import ActuatorCommand, actuator_command
from fmus.controller.arm import Arm, ControlledAxis, distance, names_in
from fmus.controller.gains import gains
from fmus.controller.harvester import ARM
from fmus.controller.learning import Motion, learned_rates
from fmus.controller.play import Compensation, beyond_limits, learned_rate
from fmus.controller.reference import Reference, engaged, reference
from fmus.controller.valve import MARGIN, Actuator, needed_pressures
from fmus.controller.variables import LEARNED, Lines, inputs, outputs, parameters, states
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number, Tables, numbers, read, values
from fmus.swing import SWING

GAINS = tuple(quantities(gains(ARM.axes)))
FILE = Path(__file__).with_name("parameters.toml")
LEAST_SUPPLY = 1e5  # Pa: keeps the use of the supply pressure finite
LEVERS = {
    "radial_lever": "radial_velocity",
    "vertical_lever": "vertical_velocity",
    "turning_lever": "swing_velocity",
}


@dataclass(frozen=True)
class Controller:
    """The functions of the subsystem for an arm."""

    arm: Arm
    states: type[Any]
    outputs: type[Any]

    def derive(self, p: Any) -> dict[str, Scalar]:
        """Hoses and lines by the equations of the drives; sections with equal flows to both sides."""
        pistons = [a.name for a in self.arm.axes if not a.turns]
        return self.arm.derive(p) | {
            f"{n}_rod_section_flow": getattr(p, f"{n}_section_flow") for n in pistons
        }

    def _actuators(self, ref: Reference, p: Any) -> dict[str, Actuator]:
        return self.arm.actuators([x for x, _ in ref.pistons], p)

    def _commands(self, x: Any, u: Any, p: Any, ref: Reference) -> dict[str, ActuatorCommand]:
        """Command of the control law for each actuator."""
        driven, measured = self._actuators(ref, p), self.arm.pressures(u)
        loads = [getattr(x, f"{a.name}_load") for a in self.arm.axes]
        late = [getattr(x, f"{a.name}_late_speed") for a in self.arm.axes]
        changes = [(v - w) / p.lead_filter_time for v, w in zip(ref.speeds, late, strict=True)]
        q = self.arm.coordinates(x, "reference_{}")
        carried = self.arm.carried(q, ref.pistons, ref.speeds, changes, loads, p)
        result = {}
        for a, speed, change, rate, (_, lever), error, (inertia, force) in zip(
            self.arm.axes, ref.speeds, changes, ref.rates, ref.pistons, ref.errors, carried, strict=True
        ):
            motion = Motion(lever * speed, lever * change, lever * rate, error, inertia, force)
            result[a.name] = actuator_command(a, driven[a.name], measured[a.name], motion, x, u, p)
        return result

    def _pressure_use(self, x: Any, u: Any, p: Any, ref: Reference) -> Scalar:
        """Supply pressure that loads and valves need in the directions demanded, over the actual one."""
        most: Scalar = 0
        for (name, a), sign in zip(self._actuators(ref, p).items(), ref.directions, strict=True):
            up, down = needed_pressures(a, getattr(x, f"{name}_load"), u.tank_pressure)
            # squares: no kink at rest
            needed = ca.fmax(ca.fmax(0, sign) ** 2 * (up + MARGIN), ca.fmax(0, -sign) ** 2 * (down + MARGIN))
            most = ca.fmax(most, needed)
        return most / ca.fmax(u.supply_pressure, LEAST_SUPPLY)

    def _compensation(self, a: ControlledAxis, x: Any, p: Any) -> Compensation:
        spool, trailing, half_width = (
            getattr(x, f"{a.name}_{n}") for n in ("spool", "trailing", "half_width")
        )
        full = self.arm.valve(a, p).full_command
        return Compensation(spool, trailing, half_width, x.coordination, full, p.reversal)

    def _valve_rates(
        self, x: Any, u: Any, p: Any, commands: Mapping[str, ActuatorCommand]
    ) -> dict[str, Scalar]:
        """Rates of the states of the valves, and of the weight of coordinated control."""
        rates: dict[str, Scalar] = {"coordination": (engaged(u) - x.coordination) / p.blend_time}
        for a in self.arm.axes:
            command, play = commands[a.name], self._compensation(a, x, p)
            full = play.full_command
            lever = ca.fmin(ca.fmax(getattr(u, f"{a.name}_lever"), -full), full)  # range of the amplifier
            target = lever + x.coordination * (command.command - lever)
            learning = ca.if_else(p.hysteresis > 0, p.hysteresis_gain, 0)
            learned = learned_rate(learning * command.missing)
            beyond = beyond_limits(play.half_width, full * p.hysteresis_limit / 2)
            rates[f"{a.name}_spool"] = (target - play.spool) / p.amplifier_time
            rates[f"{a.name}_trailing"] = play.trailing_rate
            on = engaged(u) * p.feedback
            rates |= command.lesson.rates
            active = on * p.learning * x.coordination
            of_valve, widened = learned_rates(a.name, command.lesson, play.side, x, p, active)
            rates |= of_valve
            widened = ca.if_else(p.hysteresis > 0, widened, 0) + on * (1 - p.learning) * learned
            rates[f"{a.name}_half_width"] = widened - beyond / p.unwinding_time
        return rates

    def dynamics(self, x: Any, u: Any, p: Any) -> Any:
        """Time derivative of the state."""
        on, ref = engaged(u), reference(self.arm, x, u, p)
        commands = self._commands(x, u, p, ref)
        rates = self._valve_rates(x, u, p, commands)
        for a, speed, rate in zip(self.arm.axes, ref.speeds, ref.rates, strict=True):
            name, command, gain = a.name, commands[a.name], getattr(x, f"{a.name}_gain")
            rates[f"reference_{name}"] = rate
            rates[f"{name}_late_speed"] = (speed - getattr(x, f"{name}_late_speed")) / p.lead_filter_time
            rates[f"{name}_load"] = command.load_rate
            rates[f"{name}_gain"] = on * p.feedback * command.gain_rate - (1 - on) * gain / p.tracking_time
        measured = self.arm.tip_velocity(self.arm.coordinates(u), self.arm.speeds(u), p)
        actual = (measured.radius, measured.height, measured.angle)
        for (name, velocity), now in zip(LEVERS.items(), actual, strict=True):
            value, commanded = getattr(x, name), getattr(u, velocity)
            rates[name] = on * (commanded - value) / p.lever_time + (1 - on) * (now - value) / p.tracking_time
        return self.states(**rates)

    def observe(self, x: Any, u: Any, p: Any) -> Any:
        """Outputs; commands depend on the state alone."""
        ref = reference(self.arm, x, u, p)
        rates = self._valve_rates(x, u, p, self._commands(x, u, p, ref))
        tip, found = self.arm.tip(self.arm.coordinates(u), p), dict[str, Scalar]()
        for a in self.arm.axes:
            play = self._compensation(a, x, p)
            spool, half_width = (rates[f"{a.name}_{n}"] for n in ("spool", "half_width"))
            found[f"{a.name}_command"] = play.command
            found |= {n: getattr(x, n) for n in (f"{a.name}_{k}" for k in (*LEARNED, "half_width"))}
            found[f"{a.name}_command_rate"] = play.command_rate(spool, half_width, rates["coordination"])
        return self.outputs(
            **found,
            reference_radius=ref.tip.radius,
            reference_height=ref.tip.height,
            reference_angle=ref.tip.angle,
            radial_error=ref.tip.radius - tip.radius,
            vertical_error=ref.tip.height - tip.height,
            angle_error=ref.tip.angle - tip.angle,
            tip_error=distance(ref.tip, tip),
            speed_use=ref.utilisation.speed,
            stroke_use=ref.utilisation.stroke,
            wait_use=ref.lag_ratio,
            pressure_use=self._pressure_use(x, u, p, ref),
            reference_share=ref.speed_factor,
        )

    def initial(self, _: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Reference and loads as measured; weight of coordinated control as `engaged`; assumed play."""
        q, pressures = self.arm.coordinates(u), self.arm.pressures(u)
        driven = self.arm.actuators([x for x, _ in self.arm.pistons(q, p)], p)
        start = {f"reference_{a.name}": at for a, at in zip(self.arm.axes, q, strict=True)}
        for a in self.arm.axes:
            start[f"{a.name}_load"] = driven[a.name].force(*pressures[a.name])
            start[f"{a.name}_half_width"] = p.hysteresis * self.arm.valve(a, p).full_command / 2
        return start | {"coordination": engaged(u)}

    def require(self, _x: Any, _u: Any, p: Any) -> dict[str, Scalar]:
        """Requirements: rods thinner than bores, valves that open, margins within the strokes."""
        found: dict[str, Scalar] = {}
        for a in self.arm.axes:
            if not a.turns:
                own = getattr(p, a.name)
                found[f"{a.name}_rod is thinner than {a.name}_bore"] = own.bore - own.rod
                found[f"stroke_margin is below half of {a.name}_stroke"] = own.stroke / 2 - p.stroke_margin
            valve, named = (self.arm.valve(a, of) for of in (p, names_in(p)))
            found[f"{named.full_command} exceeds {named.dead_band}"] = valve.full_command - valve.dead_band
        return found


def controller_tables(arm: Arm, parts: Sequence[Subsystem], own: Mapping[str, Number]) -> Tables:
    """Parameter and start values of the controller for a machine built from these subsystems.

    parts   of what several have, the last one's counts; each is also known with the part in front
    own     numbers of the parameters that no part has
    """
    known, start = dict(own), dict[str, Number]()
    lines, pressures = quantities(Lines), dict[str, float]()
    for sub in parts:
        given = {k: {n: _noted(x, sub) for n, x in table.items()} for k, table in numbers(sub).items()}
        known |= given["parameters"] | {f"nominal_{n}": x for n, x in given["start"].items()}
        known |= {f"{sub.component}_{n}": x for n, x in given["parameters"].items()}
        start |= {n: x for n, x in given["start"].items() if n in lines}
        pressures |= start_pressures(arm, sub)
    start |= {n: known[f"initial_{n}"] for n in (a.coordinate[0] for a in arm.axes)}
    start |= {n: Number(x, "Pa", "derived", "pressure at rest at the start") for n, x in pressures.items()}
    return {"parameters": {n: known[n] for n in quantities(parameters(arm))}, "start": start}


def start_pressures(arm: Arm, sub: Subsystem, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Initial pressures of a drive that are inputs of the controller, rounded to nine digits.

    inputs   values by name that replace start values of the drive's inputs
    """
    v, pressures = values(sub), {name for a in arm.axes for name, _ in a.sides}
    if pressures.isdisjoint(v.x):
        return {}
    u = {**v.u, **(inputs or {})}
    x = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, u, v.p))).full()[:, 0]
    return {n: float(f"{a:.9g}") for n, a in zip(v.x, x, strict=True) if n in pressures}


def _noted(number: Number, sub: Subsystem) -> Number:
    """The same value, with the component in its note."""
    return replace(number, note=f"{number.note} (as in {sub.component})")


def controller_of(arm: Arm, found: Tables) -> Subsystem:
    """The controller of an arm, with these values."""
    state, shown = states(arm.axes), outputs(arm.axes)
    of = Controller(arm, state, shown)
    return Subsystem(
        name="controller",
        text="Coordinated control of the tip: resolved rates, flow feedforward, pressure feedback",
        parameters=parameters(arm),
        states=state,
        inputs=inputs(arm.axes),
        outputs=shown,
        dynamics=of.dynamics,
        observe=of.observe,
        derive=of.derive,
        initial=of.initial,
        require=of.require,
        values=FILE if arm is ARM else None,
        numbers=found,
        terminals=tuple(ports.lever(a.name) for a in arm.axes),
        stiff=False,
        validity="valves and oil much faster than the commanded motion; swing angle not wrapped",
        model=of,
    )


def controller(
    swing: Subsystem = SWING, boom_stick: Subsystem = BOOM_STICK, manipulator: Subsystem = MANIPULATOR
) -> Subsystem:
    """The controller of a machine built from these subsystems, with their parameter values."""
    parts = (swing, boom_stick, manipulator)
    return controller_of(ARM, controller_tables(ARM, parts, read(FILE)["parameters"]))


CONTROLLER = controller()
