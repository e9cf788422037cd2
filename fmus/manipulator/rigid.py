"""The paper's manipulator: the head is a point mass at the stick end, the friction viscous.

R = B x' in the pistons, B_sw q1' in the swing gear, b_i q_i' in the joints        correction E4
"""

from __future__ import annotations

from fmus.manipulator.model import manipulator
from fmus.manipulator.variables import ManipulatorOutputs, ManipulatorParameters, ManipulatorState

RIGID = manipulator(
    text="Swing column, boom, stick and rigid processing head; viscous friction of joints and pistons",
    validity="rigid slender links, the head does not swing, viscous friction",
    parameters=ManipulatorParameters,
    states=ManipulatorState,
    outputs=ManipulatorOutputs,
)
