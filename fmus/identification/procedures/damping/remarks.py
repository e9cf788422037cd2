"""What the reader of a damping must know, in sentences."""

from __future__ import annotations

import math

import numpy as np

from fmus.identification.procedures.damping.joint import JointDamping

LITTLE = 0.1  # of a standard deviation: what is smaller is not told
SEEN = 4.0  # standard deviations from which on a dry friction is said to be seen


def remarks(one: JointDamping) -> list[str]:
    """For one joint; each begins with the parameter."""
    texts = [
        _used(one),
        *(f"in {name} the joint stands, so it is left out." for name in one.standing),
        _doubt(one),
        *_attenuated(one),
        _printed(one),
        *one.doubt.remarks(one.value, one.contact.unit),
        *_dry(one),
    ]
    return [f"{one.contact.parameter}: {text}" for text in texts]


def _used(one: JointDamping) -> str:
    samples = sum(s.good.size for s in one.records)
    share = 100 * (1 - len(one.speed) / samples)
    seconds = len(one.speed) * one.records[0].filters.step
    text = f"{seconds:.3g} s of {len(one.records)} recordings are used"
    if not share:
        return f"{text}, nothing is left out."
    ends = sum(s.touched for s in one.records)
    stops = f"; in {ends} samples a piston was at an end of its stroke" if ends else ""
    return f"{text}, {share:.2g} % is left out because of clipped or missing samples nearby{stops}."


def _doubt(one: JointDamping) -> str:
    noise, residual = (math.sqrt(max(c[0, 0], 0.0)) for c in (one.solution.noise, one.solution.residual))
    text = (
        f"the noise of the sensors gives a standard deviation of {noise:.3g} {one.contact.unit}, the "
        f"residuals one of {residual:.3g}."
    )
    if one.solution.lacks:
        return f"{text} Noise does not explain them: the model lacks something, and the interval covers it."
    return f"{text} Noise explains them, and the interval is that of the noise."


def _attenuated(one: JointDamping) -> list[str]:
    """The bias by errors in variables, where it is not lost in the interval."""
    bias = float(one.solution.mean_effect[0])
    if abs(bias) < LITTLE * one.sd:
        return []
    return [
        f"the encoders' noise in the speed moves this estimate by {100 * bias / one.value:+.2g} %, which is "
        "taken off."
    ]


def _printed(one: JointDamping) -> str:
    first = one.plain[0]
    share = 100 * (first.value / first.corrected - 1)
    return (
        f"(13) as printed, with a derivative over {first.window * 1e3:.3g} ms, gives {first.value:.4g} "
        f"{one.contact.unit}; the encoders' noise makes {share:+.2g} % of it, without which it "
        f"is {first.corrected:.4g}."
    )


def _dry(one: JointDamping) -> list[str]:
    dry, sd, left = one.dry
    if not np.isfinite(sd) or abs(dry) < SEEN * sd:
        return []
    if dry < 0:
        return [
            "resistance grows more than in proportion to the speed: dry friction beside B would be negative, "
            "which is no law of friction. Something else moves the residual, such as a number that is taken "
            "as known."
        ]
    return [
        f"the residual has the sign of the speed. A dry friction of {dry:.3g} +- {sd:.2g} "
        f"{one.contact.resistance_unit} beside a damping of {left:.4g} {one.contact.unit} fits better; the "
        "viscous law takes it into B, at the speeds of these recordings."
    ]
