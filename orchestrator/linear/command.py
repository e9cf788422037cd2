"""What `harvester linearize` does: prints the operating point and the modes, writes the model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.files import folder
from orchestrator.base.text import TextTable
from orchestrator.cli.options import assignments
from orchestrator.linear.linearize import linearize
from orchestrator.linear.model import Array, Linear, Named
from orchestrator.linear.modes import Mode

HEAD = ("frequency [Hz]", "damping [1]", "time constant [s]", "mode", "states")
ROUNDING = 1e-12
AT_REST = 1e-4  # of its size per second: a state that moves no faster counts as steady in the text
AT_ONCE = 1e-3  # s: a state that settles so soon is not told as moving ...
LITTLE = 1e-2  # ... if it goes no further than this share of its size


def speeds(texts: Iterable[str]) -> dict[str, float]:
    """{joint: speed} from the texts 'joint=speed'."""
    found = assignments(texts, "--speed", "joint=speed, such as boom=0.1")
    for name, value in found.items():
        try:
            float(value)
        except ValueError:
            raise Problem(f"--speed {name}={value}: expected a number, got {value!r}") from None
    return {name: float(value) for name, value in found.items()}


def run(system: Path, out: Path, **options: Any) -> None:
    """Linearise, print, write."""
    if out.suffix != ".npz":
        raise Problem(f"--out {out}: expected a file name ending in .npz")
    folder(out.parent)
    linear = linearize(system, **options)
    print(text(linear))
    arrays, names = linear.save(out)
    print(f"\nA, B, C, D: {arrays}\nnames and modes: {names}")


def text(linear: Linear) -> str:
    """Operating point and modes."""
    groups = {"state": linear.states, "input": linear.inputs, "output": linear.outputs}
    count = ", ".join(f"{len(group)} {word}{'s' * (len(group) != 1)}" for word, group in groups.items())
    lines = [f"{linear.name} at t = {linear.time:g} s: {count}", *_point(linear)]
    lines += [_stability(linear.modes), ""] if linear.modes else [""]
    lines += TextTable(HEAD, [_row(m) for m in linear.modes], left=(3, 4)).lines()
    return "\n".join([*lines, *(f"note: {note}" for note in linear.notes)])


def _point(linear: Linear) -> list[str]:
    """The inputs, and what is not at rest."""
    told = [f"{i.name} = {_value(v, i)}{_unit(i)}" for i, v in zip(linear.inputs, linear.u0, strict=True)]
    rate = _rates(linear)
    moving = [
        f"{linear.states[i].name} by {linear.f0[i]:.3g}{_unit(linear.states[i])} per s"
        for i in np.argsort(-rate)[:3]
    ]
    rest = [m for m, i in zip(moving, np.argsort(-rate)[:3], strict=False) if rate[i] > AT_REST]
    return [f"inputs: {', '.join(told) or 'none'}", f"not at rest: {', '.join(rest) or 'nothing'}"]


def _rates(linear: Linear) -> Array:
    """How fast each state moves, of its size per second; 0 where it settles at once, as the flow in a line.

    By itself a state of time constant T = -1 / A_ii goes f0 T further.
    """
    rate = np.abs(linear.f0) / np.array([s.size for s in linear.states])
    own = -np.diag(linear.a)
    return np.where((own > 1.0 / AT_ONCE) & (rate <= LITTLE * own), 0.0, rate)


def _stability(modes: Sequence[Mode]) -> str:
    """What does not come back."""
    grows = [m.name for m in modes if m.value.real > 0.0]
    stays = [m.name for m in modes if m.value.real == 0.0]
    told = f"unstable: {', '.join(grows)}" if grows else "stable"
    return f"{told}; on the limit: {', '.join(stays)}" if stays else told


def _value(value: float, named: Named) -> str:
    """With 6 digits; 0 for what is rounding beside its usual magnitude."""
    return f"{0.0 if abs(value) < ROUNDING * named.size else value:.6g}"


def _unit(named: Named) -> str:
    return f" {named.unit.name}" if named.unit and named.unit.name != "1" else ""


def _row(mode: Mode) -> tuple[str, ...]:
    frequency = f"{mode.frequency:.4g}" if mode.oscillates else ""
    lasts = f"{mode.time_constant:.4g}" if math.isfinite(mode.time_constant) else ""
    damping = f"{mode.damping:.3f}" if mode.oscillates else ""
    return frequency, damping, lasts, mode.name, ", ".join(mode.members)
