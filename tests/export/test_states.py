"""Saved states, and instances beside each other."""

from ctypes import byref, c_char, c_size_t

import pytest


def drive(fmu, first, count, step=0.01):
    """Steps with varying inputs; returns all variables after each step."""
    seen = []
    for k in range(first, first + count):
        fmu.set(opening=0.5 + 0.4 * ((k * 7) % 11) / 11, supply=2e7 + 1e5 * k)
        fmu.slopes(supply=1e6)
        fmu.fmu.doStep(k * step, step)
        seen.append((*fmu.get(*fmu.references), *fmu.output_slopes("pressure", "force", "pressure_rate")))
    return seen


def test_restoring_a_state_repeats_bit_by_bit(open_fmu):
    """From a saved state the instance and another one of the same FMU continue with the same bits."""
    own, other = open_fmu("chamber").start(), open_fmu("chamber")
    drive(own, 0, 5)
    saved = own.fmu.getFMUstate()
    first = drive(own, 5, 10)
    for fmu in (own, other):
        fmu.fmu.setFMUstate(saved)
        assert drive(fmu, 5, 10) == first
    own.fmu.freeFMUstate(saved)


def test_state_remembers_input_derivatives_and_parameters(open_fmu):
    """Input derivatives for the next step and tuned parameters are part of the state."""
    fmu = open_fmu("decay").start().step(0.1)
    fmu.set(target=2.0, rate=5.0)
    fmu.slopes(target=3.0)
    saved = fmu.fmu.getFMUstate()
    fmu.fmu.doStep(0.1, 0.1)
    first = fmu.get("level", "mixed", "target", "rate").tolist()
    fmu.set(target=0.0, rate=1.0)
    fmu.fmu.setFMUstate(saved)
    fmu.fmu.doStep(0.1, 0.1)
    fmu.fmu.freeFMUstate(saved)
    assert first == fmu.get("level", "mixed", "target", "rate").tolist()


def test_foreign_and_damaged_states_are_refused(open_fmu):
    """Bytes of another FMU, truncated or changed, are refused with the reason; the instance can go on."""
    gain, decay = open_fmu("gain").start(), open_fmu("decay").start()
    data, foreign = decay.state(), gain.state()
    damaged = [data[:n] + bytes([data[n] ^ 16]) + data[n + 1 :] for n in range(0, len(data), 7)]
    for wrong in (*damaged, data[:-8], foreign[:50], foreign):
        decay.refuses(lambda wrong=wrong: decay.fmu.deSerializeFMUstate(wrong))
    *_, cut, short, other = decay.errors()
    assert any("the saved state is damaged" in text for text in decay.errors())
    assert f"has {len(data) - 8} bytes, expected {len(data)}" in cut
    assert "50 bytes" in short
    assert "is of GUID" in other
    decay.step(0.1)


@pytest.mark.parametrize("end", ["terminate", "reset", "failure"])
def test_a_state_brings_an_ended_instance_back(open_fmu, end):
    """After fmi2Terminate, fmi2Reset or a failed step a saved state continues where it was taken."""
    fmu = open_fmu("blowup").start().step(0.1, 3)
    saved, time = fmu.fmu.getFMUstate(), fmu.time
    expected = fmu.step(0.1, 3)["size"]
    if end == "failure":
        fmu.refuses(lambda: fmu.fmu.doStep(fmu.time, 2.0))
    else:
        getattr(fmu.fmu, end)()
    fmu.fmu.setFMUstate(saved)
    fmu.fmu.freeFMUstate(saved)
    fmu.time = time
    assert fmu.step(0.1, 3)["size"] == expected


def test_reset_starts_again(open_fmu):
    """After fmi2Reset an instance has its default values and gives the same solution."""
    fmu = open_fmu("chamber").start()
    first = drive(fmu, 0, 5)
    fmu.fmu.reset()
    fmu.start()
    assert drive(fmu, 0, 5) == first


def test_instances_do_not_know_each_other(open_fmu):
    """Interleaved instances with other parameters give what each gives alone."""
    alone = [open_fmu("decay").start(rate=rate).step(0.1, 10)["level"] for rate in (1.0, 2.0, 3.0)]
    together = [open_fmu("decay").start(rate=rate) for rate in (1.0, 2.0, 3.0)]
    for k in range(10):
        for fmu in together:
            fmu.fmu.doStep(k * 0.1, 0.1)
    assert [fmu["level"] for fmu in together] == alone


def test_saved_state_memory_is_used_again(open_fmu):
    """fmi2GetFMUstate into an existing state writes there and allocates nothing."""
    fmu = open_fmu("decay").start()
    saved = fmu.fmu.getFMUstate()
    address = saved.value
    fmu.fmu.fmi2GetFMUstate(fmu.fmu.component, byref(saved))
    assert saved.value == address
    size = c_size_t()
    fmu.fmu.fmi2SerializedFMUstateSize(fmu.fmu.component, saved, byref(size))
    fmu.refuses(lambda: fmu.fmu.fmi2SerializeFMUstate(fmu.fmu.component, saved, (c_char * 4)(), 4))
    fmu.fmu.freeFMUstate(saved)
    assert "memory is too small" in fmu.errors()[-1]
