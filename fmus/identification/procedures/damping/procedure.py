"""Viscous damping of swing gear and pistons (section 4(d), eq. (13), Fig. 9).

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

with tau of measured pressures and M, V, G of the manipulator, the viscous friction of the joints as known.
Both sides are filtered alike and the acceleration is moved onto the filter (`balance.modulation`), so that
B is least squares of impulses and momenta; the paper's estimator is shown beside it (`as_printed`).

Validity: viscous friction, everything else known. What is not, B takes in, as the paper says: the remarks
tell how much, and whether dry friction can be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fmus.contract import ModelError
from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.balance.motion import ANGLES, PRESSURES
from fmus.identification.procedures.balance.motion import SIGNALS as MACHINE
from fmus.identification.procedures.damping.joint import CONTACTS, JointDamping, joint_damping
from fmus.identification.procedures.damping.panels import panels
from fmus.identification.procedures.damping.remarks import remarks
from fmus.identification.procedures.shared.given import training
from fmus.identification.procedures.shared.regression import symmetrical
from fmus.identification.recordings.reading import require
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

SIGNALS: Mapping[str, str] = MACHINE  # of the pressures those of the joint that moves


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """B of each joint of which there are recordings."""
    own = training(recordings, "damping", dict.fromkeys(ANGLES, "rad"))
    for r in own:
        if r.word("joint") not in CONTACTS:
            raise ModelError(
                f"{r.source}: [experiment] joint is {r.word('joint')!r}, expected {', '.join(CONTACTS)}"
            )
        require(r, dict.fromkeys(PRESSURES[r.word("joint")], "Pa"))
    parts = {joint: [r for r in own if r.word("joint") == joint] for joint in CONTACTS}
    found = [joint_damping(CONTACTS[joint], part, known) for joint, part in parts.items() if part]
    return Finding(
        procedure="damping",
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        estimates=tuple(_estimate(one) for one in found if one.value > 0),
        panels=panels(found),
        remarks=tuple(text for one in found for text in (*_refused(one), *remarks(one))),
        others=tuple(estimate for one in found for estimate in _others(one)),
    )


def _estimate(one: JointDamping) -> Estimate:
    note = "eq. (13) by impulses and momenta" + one.doubt.note()
    return _positive(symmetrical(one.contact.parameter, one.value, one.contact.unit, one.doubt.total, note))


def _positive(e: Estimate) -> Estimate:
    """The interval of a quantity that cannot be negative."""
    return Estimate(e.name, e.value, e.unit, e.sd, max(e.low, 0.0), e.high, e.note)


def _refused(one: JointDamping) -> list[str]:
    if one.value > 0:
        return []
    return [
        f"{one.contact.parameter}: {one.value:.3g} {one.contact.unit} is no damping, so it is not handed on: "
        "something that is taken as known is wrong."
    ]


def _others(one: JointDamping) -> list[Estimate]:
    """A dry friction, and B by these recordings alone where that is another interval."""
    name, unit = one.contact.parameter, one.contact.unit
    dry, sd, _ = one.dry
    found = []
    if one.doubt.matters:
        label = f"{name}, the rest known exactly"
        found.append(symmetrical(label, one.value, unit, one.sd, "by the recordings alone"))
    if dry > 0:  # one that pushes is no friction: a remark tells of it where it is clear
        label = f"dry friction beside {name}"
        force = one.contact.resistance_unit
        found.append(symmetrical(label, dry, force, sd, "as one more unknown of (13)"))
    return found
