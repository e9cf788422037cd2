"""Faults of loggers are named when a recording is read, and corrected by a key of its description."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import table

from fmus.identification.recordings.reading import doubtful
from orchestrator.base.errors import Problem
from orchestrator.data.corrections import corrected, log_faults, rate_faults
from orchestrator.data.description import SignalDescription
from orchestrator.data.logger_files import at_times
from orchestrator.data.recording import Recording, Sensor, fill_gaps, read_recording
from orchestrator.data.trace import Trace, read_trace
from orchestrator.results.validate_system import delay_note

RNG = np.random.default_rng(11)
ROW = np.arange(2000)
STEP = 1 / 200  # s
TIME = ROW * STEP
ANGLE = 170 + 60 * np.sin(TIME)  # deg
NOISY = 100 + 30 * np.sin(TIME) + RNG.normal(0, 0.1, ROW.size)
LEVER = 6 * np.sin(TIME * (1 + TIME / 20)) * (np.sin(TIME) > -0.5)


def held(values, rows):
    """What a log has from a source that sends every so many rows, here not a whole number of them."""
    sent = np.floor(np.floor(ROW / rows) * rows).astype(int)
    return values[sent]


DEG, BAR, VOLT = map(SignalDescription, ("deg", "bar", "V"))
COUNT = SignalDescription("bar", factor=0.01, offset=-50.0)
CODES = np.select([ROW % 500 == 9, ROW % 400 == 7, ROW % 450 == 7], [-9999, 65535, 65534], NOISY)
# what is in the log, its description, and what is named
NAMED = {
    "encoder 0 to 360": (ANGLE * 2 % 360, DEG, "jumps 4 times by about 360; wrap = 360 unwraps an angle"),
    "atan2": (np.angle(np.exp(1j * 4 * np.sin(TIME))), SignalDescription("rad"), "jumps .* by about 6.28319"),
    "turns": (ANGLE / 90 % 1, SignalDescription("rev"), "jumps .* by about 1; wrap = 1 "),
    "bus of 20 Hz": (held(LEVER, 10), VOLT, "each value is held for 10 samples"),
    "bus of 47 Hz": (held(NOISY, 4.25), BAR, r"each value is held for 4\.2\d samples"),
    "bus of 100 Hz": (held(NOISY, 2), BAR, "each value is held for 2 samples"),
    "every third row": (np.where(ROW % 3 == 1, held(LEVER, 15), np.nan), VOLT, "is held for 5 samples"),
    "0xFFFF": (np.where(ROW % 700 == 5, 6553.5, NOISY), BAR, r"3 samples .* \[6553\.5\]"),
    "0xFE": (np.where(ROW % 900 < 2, 254, np.round(NOISY)), SignalDescription("1"), r"6 samples .* \[254\]"),
    "three codes": (CODES, BAR, r"13 samples .* invalid = \[-9999, 65534, 65535\]"),
    "code of counts": (np.where(ROW % 700 == 5, 65535, np.round(100 * NOISY)), COUNT, r"invalid = \[65535\]"),
}


@pytest.mark.parametrize("name", NAMED)
def test_a_fault_is_named_with_its_key(name):
    """One line, and none once the key is set."""
    raw, spec, told = NAMED[name]
    (line,) = log_faults(raw, spec, STEP)
    assert re.search(told, line), line
    if "invalid" in line:
        spec = replace(spec, invalid=tuple(map(float, re.search(r"\[(.*)\]", line)[1].split(","))))
    elif "wrap" in line:
        spec = replace(spec, wrap=float(re.search(r"wrap = (\S+)", line)[1]))
    else:
        spec = replace(spec, held=True)
    assert [*log_faults(raw, spec, STEP)] == []


HEALTHY = {
    "noise": (NOISY, "bar"),
    "12 bit": (np.round(NOISY / 0.098) * 0.098, "bar"),
    "slow encoder": (np.round(ANGLE / 0.5) * 0.5, "deg"),
    "constant speed": (np.round(TIME * 7 / 0.35) * 0.35, "deg"),
    "steps of a command": (np.where(ROW % 400 < 15, 10.0, 0.0), "V"),
    "lever": (LEVER, "V"),
    "clipped": (np.minimum(NOISY, 120), "bar"),
    "one spike": (np.where(ROW == 900, 900, NOISY), "bar"),
    "constant": (np.zeros(2000), "V"),
    "no sample": (np.full(2000, np.nan), "V"),
    "gaps": (np.where(ROW % 4 == 1, NOISY, np.nan), "bar"),
    "turns of a column": (np.cumsum(ANGLE), "deg"),
    "pressure without a unit": (np.round((1e7 + 5e6 * np.sin(3 * TIME)) / 360) * 360.0, "1"),
}


@pytest.mark.parametrize("name", HEALTHY)
def test_nothing_is_named_in_a_healthy_column(name):
    """Converters, slow and fast signals, steps, clipped and missing samples are no faults of a logger."""
    values, unit = HEALTHY[name]
    assert [*log_faults(values, SignalDescription(unit), STEP)] == []


def test_codes_become_gaps_before_the_calibration():
    """They are written as the file has them; a scale of the logger may have rounded them, to a billionth."""
    raw = np.array([1.0, 65535, 3, 0.1 * 65535, -9999, 6])
    spec = SignalDescription("bar", factor=2.0, offset=1.0, invalid=(65535, 6553.5, -9999))
    np.testing.assert_array_equal(corrected(raw, raw, spec), [3, np.nan, 7, np.nan, np.nan, 13])
    near = 6553.5 * np.array([1, 1 + 1e-10, 1 + 1e-8])
    assert np.isnan(corrected(near, near, spec)).tolist() == [True, True, False]


def test_an_angle_is_unwrapped_over_gaps():
    """Whole turns are added, and the first value stays."""
    wrapped = np.where(ROW % 50 == 3, np.nan, 3 * ANGLE % 360)
    found = corrected(wrapped, TIME, replace(DEG, wrap=360.0))
    expected = np.where(ROW % 50 == 3, np.nan, 3 * ANGLE - 360)
    np.testing.assert_allclose(found, expected, atol=1e-9)  # rounding of 1e3 deg


def test_a_held_sample_is_used_once():
    """Each new one is, also where the source sends equal values; nothing else."""
    still = np.where((ROW > 500) & (ROW < 900), NOISY[500], NOISY)
    found = corrected(held(still, 4), TIME, replace(BAR, held=True))
    np.testing.assert_array_equal(found, np.where(ROW % 4 == 0, still, np.nan))


@pytest.mark.parametrize(
    ("values", "used"),
    [
        (np.interp(TIME, [2, 2.3, 6, 6.2], [0, 3, 3, 0]), ROW % 10 == 0),  # one motion of a lever
        (np.zeros(ROW.size), ROW >= 0),  # a lever that nobody moves
        (np.where((TIME >= 3) & (TIME < 7), 5.0, 0.0), ROW >= 0),  # steps of an experiment
        (np.where(ROW < 0, 1.0, np.nan), ROW < 0),
    ],
)
def test_a_held_lever_that_seldom_moves_keeps_its_samples(values, used):
    """Its rhythm is that of its usual run; without one, each row counts, so that no gap is too long."""
    found = corrected(held(values, 10), TIME, replace(VOLT, held=True))
    np.testing.assert_array_equal(found, np.where(used, values, np.nan))


def test_held_samples_without_a_rhythm_are_used_once():
    """A source that sends at irregular times: no repeat of a run that is not longer than usual."""
    starts = np.cumsum(RNG.choice([2, 3, 3, 3, 4], 600))
    sent = starts[np.searchsorted(starts, ROW[:1500], side="right") - 1] * (starts[0] <= ROW[:1500])
    found = corrected(NOISY[sent], TIME[:1500], replace(BAR, held=True))
    used = np.flatnonzero(np.isfinite(found))
    assert set(starts[starts < 1500]) <= set(used) | {0}
    assert len(used) <= np.sum(starts < 1500) + 1


def test_a_delay_moves_one_signal():
    """By whole samples, by a fraction, forwards and back; the ends keep their values."""
    late = corrected(LEVER, TIME, SignalDescription("V", delay=0.04))
    np.testing.assert_allclose(late, [*[LEVER[0]] * 8, *LEVER[:-8]], atol=1e-12)  # rounding
    early = corrected(2 * TIME, TIME, SignalDescription("V", delay=-0.0123))
    # of a line, rounding; the last three samples keep the last value
    np.testing.assert_allclose(early[:-3], 2 * (TIME[:-3] + 0.0123), atol=1e-12)
    assert early[-2:].tolist() == [2 * TIME[-1]] * 2
    gaps = corrected(np.where(ROW % 10 == 4, LEVER, np.nan), TIME, SignalDescription("V", delay=0.1))
    assert np.flatnonzero(np.isfinite(gaps))[:2].tolist() == [24, 34]


def test_a_signal_on_another_clock_has_gaps_only_where_it_is_slower():
    """A signal of the same rate is interpolated at each time, half a period off, too."""
    same = at_times(TIME, TIME + 0.0025, 5 * TIME)
    np.testing.assert_allclose(same[1:], 5 * (TIME[1:] - 0.0025), atol=1e-12)  # of a line, rounding
    assert np.isnan(same[0])
    assert np.isnan(at_times(TIME, np.array([]), np.array([]))).all()
    assert np.flatnonzero(np.isfinite(at_times(TIME, TIME[7:8], TIME[:1]))).tolist() == [7]


def test_the_keys_work_in_a_file(tmp_path, capsys):
    """Without them one line names the column and the key, in the warnings of `identify`, too."""
    rows = np.column_stack([TIME, np.where(ROW % 500 == 9, 6553.5, NOISY), 3 * ANGLE % 360])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,p,a", comments="")
    text = '[signals.p]\nunit = "bar"\n{}\n[signals.a]\nunit = "deg"\n{}\n'
    (tmp_path / "a.toml").write_text(text.format("", ""), encoding="utf-8")
    told = doubtful([read_recording(tmp_path / "a.csv")])
    assert [line.partition(": ")[2][:10] for line in told] == ["p: 4 sampl", "a: jumps 2"]
    read_trace(tmp_path / "a.csv")
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(": ")[2][:10] for line in told] == ["p: 4 sampl", "a: jumps 2"]
    keys = "invalid = [6553.5]\ndelay = 0.005", "wrap = 360"
    (tmp_path / "a.toml").write_text(text.format(*keys), encoding="utf-8")
    made = read_recording(tmp_path / "a.csv")
    assert [*made.log_faults()] == []
    read_trace(tmp_path / "a.csv")
    assert capsys.readouterr().err == ""
    assert np.flatnonzero(np.isnan(made["p"])).tolist() == [10, 510, 1010, 1510]
    np.testing.assert_allclose(made["a"], np.radians(3 * ANGLE - 360), atol=1e-9)  # 18 digits of the file


@pytest.mark.parametrize(
    ("unit", "values", "known", "told"),
    [
        ("deg", 3 * ANGLE, True, "jumps 2 times by about 360; unwrapped, as with wrap = 360"),
        ("rad", np.radians(3 * ANGLE), True, "jumps 2 times by about 6.28319; unwrapped"),
        ("1", 3 * ANGLE, True, ""),  # it may be no angle
        ("deg", 3 * ANGLE, False, ""),  # the output of another system may wrap, too
    ],
)
def test_an_angle_of_an_experiment_is_unwrapped_with_a_line(tmp_path, capsys, unit, values, known, told):
    """Without a key, before its samples are moved by a delay; any other one is named only."""
    turn = 2 * np.pi if unit == "rad" else 360
    rows = np.column_stack([TIME, values % turn])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,a", comments="")
    text = f'[signals.a]\nunit = "{unit}"\ndelay = 0.01\n'
    experiment = '[experiment]\nprocedure = "rest"\n' if known else ""
    (tmp_path / "a.toml").write_text(experiment + text, encoding="utf-8")
    made = read_recording(tmp_path / "a.csv")
    line = capsys.readouterr().err
    assert line.startswith(f"{tmp_path / 'a.csv'}: a: {told}") if told else not line
    assert [*made.log_faults()] == [] if told else "wrap = " in next(iter(made.log_faults()))
    if told:
        expected = np.radians(3 * ANGLE - 360)
        np.testing.assert_allclose(made["a"][2:], expected[:-2], atol=1e-9)  # 18 digits of the file


@table(__file__, "delays", "delay, error, told")
def test_a_reference_with_late_commands_names_the_delay(delay, error, told):
    """The played command is left out; nothing is said of a short delay, or where other errors are large."""

    def at(time):
        return {"angle": np.sin(3 * time), "pressure": 1e7 * np.cos(5 * time) * np.exp(-time / 9)}

    wrong = {name: values * (1 + error * np.sin(11 * TIME)) for name, values in at(TIME - delay).items()}
    reference = Recording(TIME, wrong | {"lever": LEVER}, {})
    line = delay_note(Trace(TIME, at(TIME) | {"lever": LEVER}), reference)
    assert told in line
    assert bool(line) == bool(told)
    assert f"`delay = {delay:.2g}`" in line or not told
    standing = Trace(TIME, {"angle": np.zeros(ROW.size), "pressure": np.ones(ROW.size), "lever": LEVER})
    assert delay_note(standing, reference) == ""


def test_samples_far_outside_the_span_do_not_drive_a_simulation():
    """They are gaps, up to the longest one; noise at an end of the span is not."""
    supply = np.where(ROW % 300 == 8, 6553.5, NOISY - NOISY.min() - 0.2)
    sensors = {"supply": Sensor(low=0.0, high=400.0)}
    made = Recording(TIME, {"supply": supply}, {"supply": "1"}, sensors=sensors)
    filled, bad = fill_gaps(made, "supply"), np.flatnonzero(supply > 400)
    np.testing.assert_allclose(filled[bad], (supply[bad - 1] + supply[bad + 1]) / 2, rtol=1e-12)  # rounding
    np.testing.assert_array_equal(np.delete(filled, bad), np.delete(supply, bad))
    long = replace(made, signals={"supply": np.where((ROW > 100) & (ROW < 130), 6553.5, supply)})
    with pytest.raises(Problem, match=r"supply: expected gaps of at most 0\.1 s, got one from 0\.505 s"):
        fill_gaps(long, "supply")
    # of a span of 400 bar a twentieth beyond its ends is noise
    for value, kept in ((415.0, True), (425.0, False), (-15.0, True), (-25.0, False)):
        one = replace(made, signals={"supply": np.where(ROW == 50, value, 200.0)})
        assert fill_gaps(one, "supply")[50] == (value if kept else 200.0)


@pytest.mark.parametrize(
    ("raw", "named"),
    [
        (held(NOISY, 10)[:220], True),  # twenty values whose first and last row are in the log
        (held(NOISY, 10)[:210], False),
        (np.where(ROW % 25 == 5, 6553.5, NOISY), True),  # 4 % of the samples
        (np.where(ROW % 16 == 5, 6553.5, NOISY), False),  # 6 %
        (0.5 * ROW % 330, True),  # jumps of 0.92 turns
        (0.5 * ROW % 320, False),  # of 0.89
    ],
)
def test_both_sides_of_what_is_named(raw, named):
    """Few values, frequent codes and other jumps may be the signal itself."""
    assert len([*log_faults(raw, DEG, STEP)]) == named


@pytest.mark.parametrize(("hold", "named"), [(0.95, True), (1.05, False)])
@pytest.mark.parametrize("rows", [1, 2])
def test_what_is_held_for_a_second_is_a_step_of_the_experiment(rows, hold, named):
    """A bus sends more often; steps of a command last for seconds, also in a slower group of the logger."""
    values = np.full((ROW.size, rows), np.nan)
    values[:, 0] = held(LEVER, 10)
    assert len([*log_faults(values.ravel(), VOLT, hold / 10 / rows)]) == named


SWAY = 40 * np.sin(TIME) + 5 * np.sin(3 * TIME)  # deg
RATE = 40 * np.cos(TIME) + 15 * np.cos(3 * TIME)  # deg/s
GYROS = {
    "deg/s read as rad/s": RATE,
    "rad/s read as deg/s": np.radians(np.radians(RATE)),
    # mounted the other way, with a zero
    "thousandths read as whole units, or ms as s": -1e3 * np.radians(0.96 * RATE + 2),
    "": np.radians(1.2 * RATE + 5),
}


@pytest.mark.parametrize("told", GYROS)
def test_a_rate_in_another_unit_is_named(told):
    """Beside the angle that it belongs to, with its noise, zero, gaps and errors of its scale."""
    angle = np.radians(SWAY) + RNG.normal(0, 1e-3, ROW.size)
    rate = np.where(ROW % 50 == 3, np.nan, GYROS[told] * (1 + RNG.normal(0, 0.05, ROW.size)))
    signals = {"other": np.radians(30 * np.sin(2 * TIME)), "angle": angle, "rate": rate}
    recording = Recording(TIME, signals, {"other": "rad", "angle": "rad", "rate": "rad/s"}, Path("a.csv"))
    lines = [*recording.log_faults()]
    assert len(lines) == bool(told)
    assert all(re.match(rf"a\.csv: rate: .* as fast as angle changes: {told}\?$", line) for line in lines)


def test_a_rate_that_belongs_to_no_signal_is_not_judged():
    """Noise, another motion, standstill, too few samples, or a speed in m/s beside an angle."""
    rates = {"noise": RNG.normal(0, 60, ROW.size), "other": 9e3 * np.cos(2.3 * TIME), "still": 0 * TIME}
    units = dict.fromkeys(rates, "rad/s") | {"angle": "rad", "speed": "m/s"}
    signals = {**rates, "angle": np.radians(SWAY), "speed": RATE}
    assert [*rate_faults(TIME, signals, units)] == []
    assert [*rate_faults(TIME[:2], {n: v[:2] for n, v in signals.items()}, units)] == []
