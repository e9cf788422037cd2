"""Why a tip is far from its path, by what its controller tells about its limits."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.tracking.follow import Array, Ride

WAIT = "controller.wait_use"
CAUSES = {
    "controller.stroke_use": "the path leads beyond the end of a stroke",
    "controller.speed_use": "the path asks for more speed than an actuator has",
    WAIT: "the machine does not follow",
}
ACTS = {WAIT: 0.5}  # above it the controller waits; the other limits act above 1


def cause(ride: Ride) -> str:
    """The limit that is exceeded most, and since when; empty where the controller tells of none."""
    if not ride.uses:
        return ""
    over: Mapping[str, Array] = {name: use / ACTS.get(name, 1.0) for name, use in ride.uses.items()}
    most = max(over, key=lambda name: float(over[name].max()))
    if not over[most].max() > 1:
        return ": no limit of the controller acts"
    began = float(ride.time[int((over[most] > 1).argmax())])
    return f": {CAUSES[most]}, from {began:.1f} s on ({most} is up to {ride.uses[most].max():.3g})"
