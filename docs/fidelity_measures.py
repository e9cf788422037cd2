"""Numbers for docs/fidelity.md: ripple of a pressure, peaks, modes of the whole machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fmus.machine.machine import wiring
from fmus.machine.parts import FERIC
from fmus.monolith import join, simulate
from fmus.operator_input.work_cycle import Move

BAR = 1e5  # Pa
SPLIT = 2.0  # Hz, between bumps and ripple
SETTLE = 0.2  # s after a ramp that belong to it: a few periods of the spools
AFTER = 0.5  # s after a stroke in which its last peak may come
FINE = 1 << 16  # points of a spectrum, far more than samples: no frequency is between two points

Trace = Mapping[str, np.ndarray]  # with "time"


@dataclass(frozen=True)
class Ripple:
    """Of a pressure while the lever is held, without its trend: RMS [bar] below and above 2 Hz.

    mean   [bar]
    peak   frequency [Hz] of the highest point of the spectrum above 2 Hz; `power` is that spectrum
    """

    mean: float
    slow: float
    fast: float
    power: np.ndarray
    frequency: np.ndarray

    @property
    def peak(self) -> float:
        above = self.frequency > SPLIT
        return float(self.frequency[above][np.argmax(self.power[above])])


def ripple(time: np.ndarray, pressure: np.ndarray, begin: float, end: float) -> Ripple:
    """What is left of a pressure [Pa] between two instants when a parabola is taken out.

    The parts below and above 2 Hz are those of its spectrum (Hann window), scaled to the RMS of the whole.
    """
    inside = (time >= begin) & (time <= end)
    at, values = time[inside] - (begin + end) / 2, pressure[inside] / BAR
    rest = values - np.polyval(np.polyfit(at, values, 2), at)
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)), FINE)) ** 2
    frequency = np.fft.rfftfreq(FINE, float(time[1] - time[0]))
    power *= np.mean(rest**2) / max(power.sum(), 1e-30)
    above = frequency > SPLIT
    slow, fast = (float(np.sqrt(power[part].sum())) for part in (~above, above))
    return Ripple(float(values.mean()), slow, fast, power, frequency)


def together(found: Sequence[Ripple]) -> Ripple:
    """Several ripples as one: the mean of their spectra."""
    power = np.mean([one.power for one in found], axis=0)
    slow, fast = (float(np.sqrt(np.mean([getattr(r, n) ** 2 for r in found]))) for n in ("slow", "fast"))
    mean = float(np.mean([one.mean for one in found]))
    return Ripple(mean, slow, fast, power, found[0].frequency)


def held(move: Move) -> tuple[float, float]:
    """Between which instants a stroke is held, without its begin."""
    top = move.start + move.rise
    return top + SETTLE, top + move.hold


def return_side(move: Move) -> str:
    """The chamber of the stick that a stroke empties."""
    return f"boom_stick.stick_{'rod' if move.command > 0 else 'head'}_pressure"


def return_ripple(trace: Trace, moves: Sequence[Move]) -> Ripple:
    """That of the stick's return pressure over several strokes."""
    return together([ripple(trace["time"], trace[return_side(m)], *held(m)) for m in moves])


def peaks(trace: Trace, moves: Sequence[Move]) -> np.ndarray:
    """Highest pressures [bar], shape (n, 2): of the driving line at the start, of the other at the stop."""
    found = []
    for m in moves:
        drive, brake = "ab" if m.command > 0 else "ba"
        fall = m.start + m.rise + m.hold
        windows = ((drive, m.start, fall), (brake, fall, fall + m.fall + AFTER))
        found.append([_highest(trace, f"swing.swing_pressure_{line}", a, b) for line, a, b in windows])
    return np.array(found)


def _highest(trace: Trace, name: str, begin: float, end: float) -> float:
    inside = (trace["time"] >= begin) & (trace["time"] <= end)
    return float(trace[name][inside].max()) / BAR


@dataclass(frozen=True)
class Mode:
    """Frequency [Hz] without damping, damping ratio, and how much each state takes part, the most first."""

    frequency: float
    damping: float
    parts: Mapping[str, float]


def modes(command: float, until: float = 2.0, **variants: str) -> list[Mode]:
    """Oscillations of the machine in its nominal pose, linearised `until` s after the start.

    command   of the stick [V], ramped up between 0.5 and 0.8 s
    """
    chosen = FERIC.chosen(**variants)
    whole = join(chosen, *wiring(chosen))
    time = np.array([0.0, 0.5, 0.8, until])
    inputs = np.tile(whole.u, (len(time), 1))
    inputs[2:, whole.inputs.index("stick_command")] = command
    states, _ = simulate(whole, time, inputs, tolerance=1e-8)
    x, u = ca.SX.sym("x", len(whole.states)), ca.SX.sym("u", len(whole.inputs))
    slope = ca.Function("slope", [x, u], [ca.jacobian(whole.right_hand_side(x, u, whole.p), x)])
    scale = whole.nominal
    return _modes(slope(states[-1], inputs[-1]).full() / scale[:, None] * scale, whole.states)


def _modes(matrix: np.ndarray, names: Sequence[str]) -> list[Mode]:
    """The oscillations of x' = A x; a state's part is the product of right and left eigenvector."""
    values, right = np.linalg.eig(matrix)
    left = np.linalg.inv(right)
    found = []
    for n in np.flatnonzero(values.imag > 0.1):
        part = np.abs(right[:, n] * left[n])
        ranked = {names[i]: float(part[i] / part.sum()) for i in np.argsort(-part)}
        found.append(Mode(abs(values[n]) / (2 * np.pi), -values[n].real / abs(values[n]), ranked))
    return sorted(found, key=lambda mode: mode.frequency)


def mode_of(found: Sequence[Mode], words: str) -> Mode | None:
    """The slowest oscillation that is led by a state with these words in its name; None for none."""
    return next((mode for mode in found if words in next(iter(mode.parts))), None)
