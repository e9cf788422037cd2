"""Saved states are complete: repeated steps give the same bits, also in another instance and process."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit.fmu import driving

from fmus.contract import Subsystem, quantities
from fmus.export.python.build import build_python, build_user
from fmus.machine.parts import FAMILIES
from python_fmu.lag import built, in_new_process
from python_fmu.test_agreement import inputs, shown

ACTUATOR = Path(__file__).parents[2] / "examples" / "my_subsystem" / "my_actuator.py"
SUBS = {s.name: s for family in FAMILIES.values() for s in family.values()}
Row = dict[str, float]
ELSEWHERE = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from kit.fmu import driving
with driving(Path(sys.argv[2])) as fmu:
    fmu.fmu.setFMUState(fmu.fmu.deSerializeFMUstate(bytes.fromhex(Path(sys.argv[3]).read_text())))
    fmu.time = 0.2
    print(fmu.step(1e-2, 7).get(*sys.argv[4:]).tobytes().hex())
"""


def repeated(
    path: Path, names: list[str], folder: Path, start: dict[str, float], last: dict[str, float]
) -> None:
    """Steps from a restored state are bit-identical, also in another instance."""
    with driving(path, **start) as fmu, driving(path) as other:
        fmu.step(1e-2, 20)
        fmu.set(**last)
        state, time = fmu.fmu.getFMUState(), fmu.time
        data = fmu.fmu.serializeFMUState(state)
        first = fmu.step(1e-2, 7).get(*names).tobytes()
        fmu.fmu.setFMUState(state)
        fmu.time = time
        again = fmu.step(1e-2, 7).get(*names).tobytes()
        other.fmu.setFMUState(other.fmu.deSerializeFMUstate(data))
        other.time = time
        elsewhere = other.step(1e-2, 7).get(*names).tobytes()
        fmu.fmu.freeFMUState(state)
    (folder / "state").write_text(bytes(data).hex(), encoding="utf-8")
    tests = Path(__file__).parents[1]
    far = in_new_process(ELSEWHERE, tests, path, folder / "state", *names).split()[-1]
    assert first == again == elsewhere == bytes.fromhex(far)


@pytest.mark.parametrize("name", SUBS)
def test_a_subsystem_repeats_its_steps(tmp_path, name):
    """A saved state contains states, inputs, their derivatives, and the step size of the solver."""
    sub: Subsystem = SUBS[name]
    rows = inputs(sub)
    repeated(build_python(sub, tmp_path), shown(sub), tmp_path, rows[0], rows[40])


def test_a_model_by_hand_repeats_its_steps(tmp_path):
    """The example repeats its steps bit-identically."""
    sub = SUBS["boom_stick"]
    rows = inputs(sub)
    names = ["boom_force", "stick_force", "boom_force_rate", "supply_flow", "return_flow"]
    assert set(names) <= set(quantities(sub.outputs))
    repeated(build_user(ACTUATOR, tmp_path), names, tmp_path, rows[0], rows[40])


def test_foreign_and_damaged_states_are_refused(tmp_path, capsys):
    """Bytes of another model and truncated or changed bytes are refused with the reason."""
    with (
        driving(built(tmp_path / "a")) as one,
        driving(built(tmp_path / "b", ("GAIN = 1.0", "GAIN = 2.0"))) as two,
    ):
        data = bytes(one.fmu.serializeFMUState(one.fmu.getFMUState()))
        for fmu, bad, why in (
            (two, data, "the saved state belongs to another model"),
            (one, data[:-8], f"the saved state has {len(data) - 8} bytes, expected {len(data)}"),
            (one, data[:-1] + b"\x01", "the saved state is damaged"),
            (one, b"", "the saved state belongs to another model"),
        ):
            with pytest.raises(Exception, match="status 3"):
                fmu.fmu.deSerializeFMUstate(bad)
            assert f"[ERROR] fmi2DeSerializeFMUstate: {why}" in capsys.readouterr().out
