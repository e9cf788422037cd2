"""Flow balance of one function: valve edges and leakage from its command, its pressures and its motion.

    dP/dt = f(P_a, P_b, x, x', u, P_s, P_t)        of both chambers

f is that of the quasi-static drives of a machine at measured signals: spool valve with the hose in series,
oil volumes, leakage. Only the coordinate is differentiated, by a filter. Unknowns are the area of each edge
at full command, the dead band of each direction, the leakage (past the seals of a cylinder; across and out
of a motor), which a rest with a load tells best, and the capacitance of the hoses. They have priors of
`PRIOR`, so that what a log does not excite keeps its value, and is no estimate.

Validity: below the modes of the hoses; openings that are straight behind the dead band, with the rounding of
the file; no compensated sections, whose flow does not depend on the drop; both chambers above `FILLED`. The
law differs from drives with oil columns by `LAW_OFF`, which the intervals contain.
Reference: H. E. Merritt, Hydraulic Control Systems, Wiley 1967, chapter 6 (continuity of an actuator).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fmus.components import oil
from fmus.components.opening_curve import POINTS
from fmus.contract import flat
from fmus.identification import balance
from fmus.identification.balance import Law, Samples
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.momentum_balance import MeasuredArm, at, smoothing
from fmus.identification.procedures.procedure import (
    Contradicted,
    Fit,
    Parts,
    Procedure,
    Recordings,
    delay_of,
    misfit,
)
from fmus.identification.recordings.masks import good_all
from fmus.identification.results import BAR, Estimate, Finding, Panel
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

EDGES = {"P-A": "pa", "A-T": "at", "P-B": "pb", "B-T": "bt"}
OUT, IN = "dead band out", "dead band in"  # of a positive and of a negative command
LINES = ("supply_pressure", "tank_pressure")
FILLED = 2e5  # Pa, below which a chamber may have cavities
SHORT = 1e-3  # m: the pressures of a motor are those at its valve, in front of the friction of its lines
PRIOR = 1.0  # standard deviation over the value of the file
# of what may be 0 in the file: dead band [V]; leakage [m3/(s.Pa)], 6 L/min at 100 bar
LEAST = {"V": 0.5, "m3/(s.Pa)": 1e-11}
# sd of estimates from drives with oil columns without noise, over the value; seen of five cranes, not derived
LAW_OFF = {"m2": 1e-3, "V": 3e-3, "m3/(s.Pa)": 5e-3, "m3/Pa": 0.05}
# residuals over the noise above which the law is another one: drives with oil columns had 3.1 at most,
# compensated sections 16 to 18
ANOTHER = 5.0
NOTE = "flow balance of the function"


@dataclass(frozen=True, eq=False)
class Function:
    """A joint with its drive.

    arm          with quasi-static drives
    joint        its name
    parameters   `part.name` -> known value
    lines        pressures of `LINES` that are taken where there is no reading [Pa]
    """

    arm: MeasuredArm
    joint: str
    parameters: Mapping[str, Number]
    lines: Mapping[str, float]

    @cached_property
    def part(self) -> str:
        """Name of the part with its drive."""
        return self.arm.pressures[self.joint][0].partition(".")[0]

    def parameter(self, name: str) -> str:
        """`part.name` of a parameter of its drive."""
        return f"{self.part}.{self.joint}_{name}"

    def known(self, name: str) -> float:
        """Value of a parameter of its drive, or of all of the part."""
        own = self.parameters.get(self.parameter(name))
        return (own or self.parameters[f"{self.part}.{name}"]).value

    @staticmethod
    def points(edge: str) -> list[str]:
        """Parameters of the curve of an edge of `EDGES`, without the joint: commands, then openings."""
        return [f"valve_{edge}_{n}_{k}" for n in ("command", "opening") for k in range(1, POINTS + 1)]

    @cached_property
    def signals(self) -> dict[str, str]:
        """Coordinate, pressures and command, with their SI units."""
        names = self.arm.angles[self.arm.index(self.joint)], *self.arm.pressures[self.joint]
        return {n: self.arm.signals[n] for n in names} | {self.parameter("command"): "V"}

    @cached_property
    def others(self) -> dict[str, str]:
        """Unknowns besides edges and dead bands -> parameter; leakage is the conductance of a resistance."""
        if self.joint in self.arm.cylinders:
            return {"leakage past the seals": "seal_conductance", "capacitance": "hose_capacitance"}
        leaks = {f"{n} leakage": f"{n}_leakage_resistance" for n in ("internal", "external")}
        return leaks | {"capacitance": "line_capacitance"}

    @cached_property
    def start(self) -> dict[str, tuple[float, str]]:
        """Unknowns with their values by the file, and their units."""
        found = dict[str, tuple[float, str]]()
        for edge, short in EDGES.items():  # of a narrower edge the last point of its table
            shares = [self.known(n) for n in self.points(short)[POINTS:]]
            found[edge] = self.known("valve_area") * (max(shares) or 1.0), "m2"
        found |= dict.fromkeys((OUT, IN), (self.known("valve_dead_band"), "V"))
        for n, name in self.others.items():
            value = self.known(name) ** (-1 if name.endswith("resistance") else 1)
            found[n] = value, "m3/Pa" if n == "capacitance" else "m3/(s.Pa)"
        return {f"{self.joint} {n}": x for n, x in found.items()}

    @cached_property
    def law(self) -> Law:
        """z: coordinate, speed, both pressures, command, supply and tank pressure; the constants are p."""
        arm, e, z = self.arm, self.arm.equations, ca.SX.sym("z", 7)
        unknowns = {n: ca.SX.sym("u") for n in self.start}
        own = {n.removeprefix(f"{self.joint} "): x for n, x in unknowns.items()}
        q, w, *pressures, command, supply, tank = ca.vertsplit(z)
        ends = [name.partition(".")[2] for name in arm.pressures[self.joint]]
        measured = dict(zip((*ends, *LINES), (*pressures, supply, tank), strict=True))
        measured |= {f"{self.joint}_command": command, f"{self.joint}_speed": w}
        measured["oil_temperature"] = ca.SX(oil.REFERENCE)
        if self.joint in arm.cylinders:
            k, pose = arm.cylinders.index(self.joint), ca.SX.zeros(e.q.shape[0])
            pose[arm.index(self.joint)] = q
            x, lever = ca.substitute([e.position[k], e.moment_arm[k]], [e.q], [pose])
            measured |= {f"{self.joint}_position": x, f"{self.joint}_velocity": lever * w}
        sub = next(sub for sub in arm.drives if sub.name == self.part)
        rates = flat(
            sub.dynamics(at(sub.states, measured), at(sub.inputs, measured), arm.parameters_of(sub, e.p))
        )
        given = {f"valve_{short}_command_2": ca.SX(0) for short in EDGES.values()}  # no tables
        given["valve_dead_band"] = ca.if_else(command > 0, own[OUT], own[IN])
        given |= {n: 1 / own[x] if n.endswith("resistance") else own[x] for x, n in self.others.items()}
        given |= {} if self.joint in arm.cylinders else {"line_length": ca.SX(SHORT)}
        rows = list[ca.SX]()
        for end, edges in zip(ends, (("P-A", "A-T"), ("B-T", "P-B")), strict=True):
            area = {"valve_area": ca.if_else(command > 0, own[edges[0]], own[edges[1]])}
            old = e.p[[arm.parameters.index(self.parameter(n)) for n in given | area]]
            rows.append(ca.substitute(rates[end], old, ca.vertcat(*(given | area).values())))
        return balance.law(z, unknowns, e.p, ca.vertcat(*rows), ca.vertcat(*pressures))

    def samples(self, recording: Recording) -> Samples:
        """A recording."""
        (kernel, windows), sensors = smoothing(recording), (*self.signals, *LINES)
        read = [n for n in sensors if n in recording.signals]
        sampled = [n for n in read if n != sensors[3]]  # the command is exact
        count = recording.time.size
        raw = [recording.interpolated(n) if n in read else np.full(count, self.lines[n]) for n in sensors]
        noise = [data.noise_sd(recording, n) if n in sampled else 0.0 for n in sensors]
        value, derivative, _ = kernel.weights
        corners = (np.arange(kernel.size) == kernel.size // 2) * 1.0  # of the command stay
        filters = (value, derivative, value, value, corners, value, value)
        filled = np.all(np.array(raw[1:3]) > FILLED, axis=0)
        given = np.isfinite(recording[sensors[3]])
        good = np.asarray(good_all(recording, sampled) & filled & given)
        whole = np.asarray(sliding_window_view(good, kernel.size).all(axis=1))
        known = self.arm.vector(self.parameters)
        return replace(
            balance.samples_of(self.law, sensors, np.array(raw), np.array(noise), list(known)),
            **windows,
            channels=[*zip((0, 0, 1, 2, 3, 4, 5), filters, strict=True)],
            starts=balance.window_starts(whole, windows["bump"].size),
        )

    @cached_property
    def procedure(self) -> Procedure:
        """What is estimated."""
        priors = {n: max(PRIOR * x, LEAST.get(unit, 0.0)) for n, (x, unit) in self.start.items()}

        def parts(tests: Recordings, _: object) -> Parts:
            found = [data.with_course(r, self.samples(r)) for r in tests]
            if not any(s.starts.size for s, _ in found):
                pressures = " and ".join(self.arm.pressures[self.joint])
                filled = f"{pressures} above {FILLED / BAR[1]:g} bar"
                raise Problem(f"expected a stretch without a gap or clipped sample and {filled}, got none")
            return [(s, along) for s, along in found if s.starts.size]

        def fitting(fit: Fit) -> None:
            if (times := fit.solution.fit.times_noise) > ANOTHER:
                told = f"residuals of {times:.3g} times the noise, expected {ANOTHER:g} at most"
                cause = "another kind of valve, such as a compensated section"
                lag = -(fit.taken + fit[delay_of(fit.late)]) if fit.late else 0.0
                if lag * fit.solution.samples[0].rate > 1:  # more than a sample
                    of = f"the spool follows with a lag of about {1e3 * lag:.0f} ms"
                    cause = f"{of}, which neither this law nor that of the masses has, or {cause}"
                raise Contradicted(f"{told}: {cause}")

        def estimates(fit: Fit) -> Iterator[Estimate]:
            for n, (_, unit) in self.start.items():
                if fit.sd(n) <= balance.DETERMINED * priors[n]:
                    sd = float(np.hypot(fit.sd(n), LAW_OFF[unit] * fit[n]))
                    yield Estimate.normal(n, fit[n], unit, sd, NOTE)

        def findings(fit: Fit) -> Iterator[Finding]:
            # commands, and lines without a reading, are exact: the noise of the others is tested
            own = [replace(s, raw=s.raw[:3], sd=s.sd[:3]) for s in fit.solution.samples]
            yield misfit(fit.label, replace(fit.solution, samples=own))

        def panels(fit: Fit) -> Iterator[Panel]:
            for e in (e for e in estimates(fit) if e.unit == "m2"):
                of = "rate of pressure"
                axes = Panel(f"{of} per area", of, (), e.name, ("bar/(s.mm2)", 1e11), ("bar/s", 1e5))
                yield from fit.line(axes, e.name, int("B" in e.name.rpartition(" ")[2]))

        def remarks(fit: Fit) -> Iterator[str]:
            told = [e.name for e in estimates(fit)]
            if left := [n for n in self.start if n not in told]:
                yield f"The logs do not tell {', '.join(left)}: as in the file."
            for n in (n for n in LINES if not all(n in r.signals for r in fit.recordings)):
                yield f"No reading of {n}: taken as {self.lines[n] / BAR[1]:g} bar."

        return Procedure(
            name=f"{self.joint}: valve and leakage",
            title=f"{self.joint.capitalize()}: edges of its valve",
            figure=0,
            signals=self.signals,
            law="The flow balance",
            samples=parts,
            start=lambda _: {n: x for n, (x, _) in self.start.items()},
            priors=priors,
            limits=lambda tests: data.zero_limits(tests, self.arm.pressures[self.joint]),
            loggers=[[self.parameter("command")]],
            estimates=estimates,
            panels=panels,
            remarks=remarks,
            findings=findings,
            check=fitting,
        )
