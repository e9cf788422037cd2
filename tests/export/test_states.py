"""Saved states, many instances, threads, and what an FMU costs in memory."""

import threading
from ctypes import CDLL, byref, c_char, c_size_t, c_void_p

import fmpy
import pytest
from kit.fmu import elsewhere


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


def test_serialised_state_continues_in_a_new_process(open_fmu, unpacked):
    """Bytes written here, read by a new process: the next step gives the same bits."""
    fmu = open_fmu("chamber").start()
    drive(fmu, 0, 5)
    fmu.time = 0.05
    there = elsewhere(unpacked[2, "chamber"], fmu.state(), fmu.time, 0.01, 1, *fmu.references)
    assert there == fmu.step(0.01).get(*fmu.references).tobytes()


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


def test_failed_step_can_be_taken_back(open_fmu):
    """After an error an instance can continue from a saved state."""
    fmu = open_fmu("blowup").start()
    saved = fmu.fmu.getFMUstate()
    fmu.refuses(lambda: fmu.fmu.doStep(0.0, 2.0))
    fmu.fmu.setFMUstate(saved)
    fmu.fmu.freeFMUstate(saved)
    fmu.fmu.doStep(0.0, 0.5)
    # 1 / (1 - t); integrator error at tolerance 1e-6
    assert fmu["size"] == pytest.approx(2.0, rel=1e-5)


def test_reset_starts_again(open_fmu):
    """After fmi2Reset an instance has its default values and gives the same solution."""
    fmu = open_fmu("chamber").start()
    first = drive(fmu, 0, 5)
    fmu.fmu.reset()
    fmu.start()
    assert drive(fmu, 0, 5) == first


def test_instances_do_not_know_each_other(open_fmu):
    """Interleaved instances with other parameters give what each gives alone."""
    alone = []
    for rate in (1.0, 2.0, 3.0):
        fmu = open_fmu("decay")
        fmu.set(rate=rate)
        alone.append(fmu.start().step(0.1, 10)["level"])
    together = [open_fmu("decay") for _ in alone]
    for fmu, rate in zip(together, (1.0, 2.0, 3.0), strict=True):
        fmu.set(rate=rate)
        fmu.start()
    for k in range(10):
        for fmu in together:
            fmu.fmu.doStep(k * 0.1, 0.1)
    assert [fmu["level"] for fmu in together] == alone


def test_threads_give_the_same_bits(open_fmu):
    """Eight instances in eight threads at once: eight times the same result."""
    instances = [open_fmu("vanderpol").start() for _ in range(8)]
    threads = [threading.Thread(target=fmu.step, args=(0.01, 300)) for fmu in instances]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({tuple(fmu.get("x", "v")) for fmu in instances}) == 1


def test_thousand_instances_at_once_and_freed(unpacked):
    """A thousand instances with saved states can coexist and free their memory."""
    library = CDLL(str(unpacked[2, "decay"] / "binaries" / "linux64" / "decay.so"))
    guid = fmpy.read_model_description(str(unpacked[2, "decay"]), validate=False).guid.encode()
    for name in ("fmi2Instantiate", "fmi2FreeInstance", "fmi2GetFMUstate", "fmi2FreeFMUstate"):
        getattr(library, name).restype = c_void_p if name == "fmi2Instantiate" else None
    before = _resident()
    for _ in range(3):
        made = [c_void_p(library.fmi2Instantiate(b"i", 1, guid, b"", None, 0, 0)) for _ in range(1000)]
        assert all(made)
        states = []
        for instance in made:
            state = c_void_p()
            library.fmi2GetFMUstate(instance, byref(state))
            states.append(state)
        for instance, state in zip(made, states, strict=True):
            library.fmi2FreeFMUstate(instance, byref(state))
            library.fmi2FreeInstance(instance)
    # 3 x 1000 x some 3 kB would be 9 MB; the allocator keeps some pages
    assert _resident() - before < 8e6


def _resident() -> float:
    """Memory of this process [bytes]."""
    with open("/proc/self/statm") as file:
        return float(file.read().split()[1]) * 4096


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
