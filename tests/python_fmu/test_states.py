"""Saved states are complete: repeated steps give the same bits, also in another instance and process."""

from pathlib import Path

import pytest
from kit.every import EVERY, row
from kit.fmu import driving, elsewhere

from fmus.contract import quantities
from python_fmu.lag import built


def repeated(path: Path, names: list[str], start: dict[str, float], last: dict[str, float]) -> None:
    """Steps from a restored state are bit-identical, also in another instance and in another process."""
    with driving(path, **start) as fmu, driving(path) as other:
        fmu.step(1e-2, 20).set(**last)
        state, time = fmu.fmu.getFMUState(), fmu.time
        data = fmu.state()
        first = fmu.step(1e-2, 7).get(*names).tobytes()
        fmu.fmu.setFMUState(state)
        fmu.fmu.freeFMUState(state)
        fmu.time = time
        again = fmu.step(1e-2, 7).get(*names).tobytes()
        beside = other.restore(data, time).step(1e-2, 7).get(*names).tobytes()
    assert first == again == beside == elsewhere(path, data, time, 1e-2, 7, *names)


def test_a_model_by_hand_repeats_its_steps(actuator):
    """The example repeats its steps bit-identically."""
    sub = EVERY["boom_stick_lumped"]
    names = ["boom_force", "stick_force", "boom_force_rate", "supply_flow", "return_flow"]
    assert set(names) <= set(quantities(sub.outputs))
    repeated(actuator, names, row(sub, 0), row(sub, 40))


def test_foreign_and_damaged_states_are_refused(tmp_path, capsys):
    """Bytes of another model and truncated or changed bytes are refused with the reason."""
    with (
        driving(built(tmp_path / "a")) as one,
        driving(built(tmp_path / "b", ("GAIN = 1.0", "GAIN = 2.0"))) as two,
    ):
        data = one.state()
        for fmu, bad, why in (
            (two, data, "the saved state belongs to another model"),
            (one, data[:-8], f"the saved state has {len(data) - 8} bytes, expected {len(data)}"),
            (one, data[:-1] + b"\x01", "the saved state is damaged"),
            (one, b"", "the saved state belongs to another model"),
        ):
            with pytest.raises(Exception, match="status 3"):
                fmu.fmu.deSerializeFMUstate(bad)
            assert f"[ERROR] fmi2DeSerializeFMUstate: {why}" in capsys.readouterr().out
