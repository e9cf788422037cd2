"""Random cranes in one plane, drawn from a seed, and the loads that they hold by another calculation."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus.crane.description import CraneDescription, read

GRAVITY, PRESSURE = 9.80665, 2.1e7  # m/s2, Pa


@dataclass(frozen=True)
class Boom:
    """A revolute joint, or a telescope along x; lengths [m], angles [rad], mass [kg].

    base, pin   of the cylinder, as x + i z; bore and rod
    ends        of the angle or the extension
    """

    length: float
    mass: float
    centre: complex
    base: complex
    pin: complex
    bore: float
    rod: float
    ends: tuple[float, float]
    slides: bool = False

    @property
    def forces(self) -> tuple[float, float]:
        """Push and pull [N]."""
        return PRESSURE * np.pi / 4 * self.bore**2, PRESSURE * np.pi / 4 * (self.bore**2 - self.rod**2)

    def cylinder(self, angle: np.ndarray | float) -> np.ndarray:
        """Length from pin to pin [m]."""
        return np.abs(self.pin * np.exp(1j * np.asarray(angle)) - self.base)

    def lever(self, angle: np.ndarray) -> np.ndarray:
        """Distance of the joint from the line of the cylinder [m]."""
        if self.slides:
            return np.ones_like(angle)
        pin = self.pin * np.exp(1j * angle)
        along = (pin - self.base) / np.abs(pin - self.base)
        return (np.conj(pin) * along).imag


def draw(seed: int) -> list[Boom]:
    """Two to four joints; the last of three or four may be a telescope."""
    rng, found = np.random.default_rng(seed), list[Boom]()
    count = int(rng.integers(2, 5))
    telescope = count > 2 and rng.random() < 0.5
    while len(found) < count:
        bore, length = rng.uniform(0.06, 0.16), rng.uniform(0.7, 3.5)
        rod, mass = bore * rng.uniform(0.45, 0.7), rng.uniform(20, 90) * length
        if telescope and len(found) == count - 1:
            ends = (0.0, rng.uniform(0.3, 0.9) * found[-1].length)
            found.append(Boom(0.2, mass, complex(-ends[1] / 2), 0j, 0j, bore, rod, ends, slides=True))
            continue
        base = rng.uniform(0.4, 1.5) * np.exp(1j * (rng.uniform(-2.4, -1.0) if not found else np.pi))
        base *= np.exp(1j * (0 if not found else rng.uniform(-0.4, 0.1)))
        pin = rng.uniform(0.25, 0.6) * np.exp(1j * rng.uniform(-0.3, 2.2))
        opening = rng.uniform(0.4, 1.2)  # between the lines to both pins, at the closed end
        low = opening + np.angle(base) - np.angle(pin)
        low -= 2 * np.pi * np.round(low / (2 * np.pi))
        ends = (low, low + rng.uniform(0.6, 2.6 - opening))
        centre = length * complex(rng.uniform(0.3, 0.6), rng.uniform(-0.1, 0.1))
        boom = Boom(length, mass, centre, base, pin, bore, rod, ends)
        closed, opened = boom.cylinder(np.array(ends))
        if closed > (opened - closed) + 1.5 * bore and abs(sum(ends)) < 2.5:  # a cylinder, a usual place
            found.append(boom)
    return found


def described(booms: list[Boom]) -> CraneDescription:
    """The crane as its file says it, which starts in the middle of all ranges."""
    lines, at, starts = list[str](), 0.0, list[str]()
    for k, b in enumerate(booms):
        lines += [f"[j{k}]", f'joint = "{"prismatic" if b.slides else "revolute"}"']
        lines += [f'axis = "{"x" if b.slides else "-y"}"', f"at = [{at:.17g}, 0, 0]", f"mass = {b.mass:.17g}"]
        lines += [f"centre = [{b.centre.real:.17g}, 0, {b.centre.imag:.17g}]", "inertia = [0, 10, 10]"]
        lines += ["damping = 100", 'drive = "cylinder"']
        pins = ""
        if not b.slides:
            closed, opened = b.cylinder(np.array(b.ends))
            for name, pin in (("base", b.base), ("pin", b.pin)):
                pins += f"{name} = [{pin.real:.17g}, {pin.imag:.17g}], "
            pins += f"closed = {closed:.17g}, "
        stroke = b.ends[1] if b.slides else float(opened - closed)
        rest = f"stroke = {stroke:.17g}, bore = {b.bore:.17g}, rod = {b.rod:.17g}"
        lines.append(f"cylinder = {{ {pins}{rest} }}")
        starts.append(f"j{k} = {np.mean(b.ends):.17g}")
        at = b.length
    lines += [f'[payload]\non = "j{len(booms) - 1}"\nat = [{at:.17g}, 0, 0]', "[start]", *starts]
    lines.append(f"[supply]\npressure = {PRESSURE}")
    return read(Path("random.toml"), "\n".join(lines).encode())


def _frames(booms: list[Boom], q: list[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Places of the joints, as x + i z [m], and angles of their links."""
    place, angle, before = np.zeros_like(q[0]) * 0j, np.zeros_like(q[0]), 0.0
    places, angles = list[np.ndarray](), list[np.ndarray]()
    for b, x in zip(booms, q, strict=True):
        place = place + (before + (x if b.slides else 0.0)) * np.exp(1j * angle)
        angle, before = angle + (0.0 if b.slides else x), b.length
        places.append(place)
        angles.append(angle)
    return places, angles


def tip(booms: list[Boom], q: list[np.ndarray]) -> np.ndarray:
    """As x + i z [m], in poses (m,)."""
    places, angles = _frames(booms, q)
    return places[-1] + booms[-1].length * np.exp(1j * angles[-1])


def held(booms: list[Boom], q: list[np.ndarray]) -> np.ndarray:
    """Load [kg] in poses (m,): moments about each joint, or the weight along the telescope."""
    places, angles = _frames(booms, q)
    end, load, stands = tip(booms, q), np.full(q[0].shape, np.inf), np.full(q[0].shape, True)
    centres = [p + b.centre * np.exp(1j * a) for b, p, a in zip(booms, places, angles, strict=True)]
    for k, b in enumerate(booms):
        per_kilogram = [np.sin(angles[k]) if b.slides else (c - places[k]).real for c in (*centres, end)]
        per_kilogram = GRAVITY * np.array(per_kilogram) / b.lever(q[k])
        weights = (o.mass * f for o, f in zip(booms[k:], per_kilogram[k:-1], strict=True))
        alone, more = sum(weights), per_kilogram[-1]
        push, pull = b.forces
        stands &= (alone <= push) & (alone >= -pull)
        with np.errstate(divide="ignore", invalid="ignore"):
            load = np.minimum(load, np.where(more > 0, push - alone, pull + alone) / np.abs(more))
    return np.where(stands, np.maximum(load, 0.0), 0.0)


FINE = {1: 20_001, 2: 300, 3: 50}  # poses along each joint but the first, by their number


def largest(booms: list[Boom], reach: float) -> float:
    """Largest load [kg] with the tip at a reach: the first angle follows from it, the others are a grid.

    Then a grid around the best pose, eight times, each a third as wide.
    """
    best, windows, count = 0.0, [b.ends for b in booms[1:]], FINE[len(booms) - 1]
    for _ in range(9):
        lines = [np.linspace(*w, count) for w in windows]
        q = [x.ravel() for x in np.meshgrid(*lines, indexing="ij")]
        loads = np.full(q[0].size, -1.0)
        arm, ends = tip(booms, [np.zeros_like(q[0]), *q]), booms[0].ends
        for side, sign in ((reach, 1), (reach, -1), (-reach, 1), (-reach, -1)):
            some = np.flatnonzero(np.abs(arm) >= reach)
            first = sign * np.arccos(side / np.abs(arm[some])) - np.angle(arm[some])
            first -= 2 * np.pi * np.round((first - np.mean(ends)) / (2 * np.pi))
            inside = (first >= ends[0]) & (first <= ends[1])
            some = some[inside]
            loads[some] = np.maximum(loads[some], held(booms, [first[inside], *(x[some] for x in q)]))
        k = int(np.argmax(loads))
        best = max(best, float(loads[k]))
        half = [3 * (w[1] - w[0]) / (count - 1) if count > 13 else (w[1] - w[0]) / 6 for w in windows]
        around = zip(q, half, booms[1:], strict=True)
        windows = [(max(x[k] - h, b.ends[0]), min(x[k] + h, b.ends[1])) for x, h, b in around]
        count = 13
    return best
