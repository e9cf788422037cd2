"""Saved states are complete: repeated steps give the same bits, also in another instance and process."""

from kit.every import EVERY, row
from kit.fmu import driving, in_new_process

from fmus.contract import quantities

NAMES = ["boom_force", "stick_force", "boom_force_rate", "supply_flow", "return_flow"]
ELSEWHERE = """
import sys
from kit.fmu import driving
path, state, time, *names = sys.argv[1:]
with driving(path) as fmu:
    print(fmu.restore(bytes.fromhex(state), float(time)).step(1e-2, 7).get(*names).tobytes().hex())
"""


def test_a_model_by_hand_repeats_its_steps(actuator):
    """Steps from a restored state are bit-identical, also in another instance and in another process."""
    sub = EVERY["boom_stick_lumped"]
    assert set(NAMES) <= set(quantities(sub.outputs))
    with driving(actuator, **row(sub, 0)) as fmu, driving(actuator) as other:
        fmu.step(1e-2, 20).set(**row(sub, 40))
        state, time, data = fmu.fmu.getFMUState(), fmu.time, fmu.state()
        first = fmu.step(1e-2, 7).get(*NAMES).tobytes()
        fmu.fmu.setFMUState(state)
        fmu.fmu.freeFMUState(state)
        fmu.time = time
        again = fmu.step(1e-2, 7).get(*NAMES).tobytes()
        beside = other.restore(data, time).step(1e-2, 7).get(*NAMES).tobytes()
    elsewhere = bytes.fromhex(in_new_process(ELSEWHERE, actuator, data.hex(), time, *NAMES))
    assert first == again == beside == elsewhere
