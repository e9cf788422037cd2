"""Rest procedure: zeros of pressure sensors and flow meters, from a recording with the pump off and no load.

All true pressures and flows are zero, so the mean of a reading is the zero of its sensor. Ten seconds are
enough: 2000 samples reduce the noise forty times. The zeros are subtracted from the signals of the same name
in all recordings (`subtracted`), before any other procedure, and the errors of the means replace the limits
of the data sheets.

A transducer whose range begins at zero cuts half of its noise at rest. With the share P of readings up to the
lowest one and the noise sd of the data sheet, its zero is  low + resolution/2 - sd Phi^-1(P).

Validity: pump off, pressures relieved, no motion. A meter in its dead zone does not tell its zero.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from fmus.identification.balance import probability
from fmus.identification.procedures.experiment_data import training_recordings, zero_limit
from fmus.identification.procedures.procedure import METERS, Computed
from fmus.identification.recordings.masks import in_dead_zone, standard_error
from fmus.identification.results import Curve, Estimate, Finding, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = {}  # of any name; those in Pa and m3/s are read
READ = {"Pa": METERS["pressure"], "m3/s": METERS["flow"]}
CUT = 0.01  # share of readings at the lowest one from which on the mean is not the zero
LARGEST = 20.0  # limits of the data sheet above which the machine was not at rest
LOADED = "expected a reading near zero, with the pump off and all pressures relieved"


def identify(recordings: Sequence[Recording], _parameters: Mapping[str, Number]) -> ProcedureResult:
    """The zero of each pressure sensor and flow meter that was recorded at rest."""
    tests = training_recordings(recordings, "rest", SIGNALS)
    zeros, findings, unknown = dict[str, Estimate](), list[Finding](), list[str]()
    note = "mean at rest, subtracted from all recordings"
    for recording, name in ((r, n) for r in tests for n, unit in r.units.items() if unit in READ):
        zero, sd = _zero(recording, name)
        if not math.isfinite(sd):
            unknown.append(name)
            continue
        unit, limit = recording.units[name], zero_limit(recording, name)
        kind, (display, one) = READ[unit]
        if abs(zero) > LARGEST * limit + 10 * sd:
            raise Problem(f"{recording.source}: {name}: {LOADED}, got {zero / one:.3g} {display}")
        sentence = (
            f"rest: the zero of {name} is {zero / one:.3g} +- {sd / one:.2g} {display}; the declared "
            f"limit is {limit / one:.3g} {display}"
        )
        findings.append(Finding(f"zero of a {kind}", probability(zero, sd, limit), sentence))
        zeros[name] = Estimate.normal(name, zero, unit, sd, note)
    return ProcedureResult(
        procedure="rest",
        title="Zeros of the sensors, at rest",
        figure=0,
        estimates=(),
        panels=tuple(_panels(tests[0], zeros)),
        remarks=(
            f"Zeros of {len(zeros)} sensors are subtracted from their signals in all recordings.",
            *(f"{n}: does not tell its zero: in its dead zone, or at the end of its range." for n in unknown),
        ),
        others=tuple(zeros.values()),
        findings=tuple(findings),
    )


def _zero(recording: Recording, name: str) -> tuple[float, float]:
    """Zero of a sensor and its standard deviation, infinite if the recording does not tell it."""
    sensor = recording.sensor(name)
    values = recording[name][np.isfinite(recording[name]) & ~in_dead_zone(recording[name], sensor)]
    if values.size < 2 or not values.size > recording.time.size / 2:
        return 0.0, math.inf
    cut = float(np.mean(values <= sensor.low + sensor.resolution / 2))
    if cut < CUT:
        return float(values.mean()), max(standard_error(values, sensor.resolution), 1e-30)
    if cut > 1 - CUT or not sensor.noise > 0:
        return 0.0, math.inf
    quantile = float(stats.norm.ppf(cut))
    sd = sensor.noise * math.sqrt(cut * (1 - cut) / values.size) / float(stats.norm.pdf(quantile))
    return sensor.low + sensor.resolution / 2 - sensor.noise * quantile, sd


def subtracted(recordings: Sequence[Recording], result: ProcedureResult) -> list[Recording]:
    """The recordings without these zeros, whose limits follow from the errors of the estimates.

    A sensor of the machine that declares no limit has none afterwards, because its zero is not estimated.
    """
    corrected = []
    for r in recordings:
        signals, sensors = dict(r.signals), dict(r.sensors)
        for e in (e for e in result.others if e.name in r.signals and r.procedure != "rest"):
            s, n = r.sensor(e.name), e.name
            error = (
                None if s.zero_error is None and "." in n else e.sd * math.sqrt(3)
            )  # its `limit_sd` is e.sd
            signals[n] = r[n] - e.value
            sensors[n] = replace(s, low=s.low - e.value, high=s.high - e.value, zero_error=error)
        corrected.append(replace(r, signals=signals, sensors=sensors))
    return corrected


def _panels(recording: Recording, zeros: Mapping[str, Estimate]) -> Iterator[Panel]:
    """Readings over time, pressures and flows apart."""
    for unit, (kind, display) in READ.items():
        curves = tuple(
            Curve(n, recording.time, recording[n]) for n in zeros if recording.units.get(n) == unit
        )
        if curves:
            yield Panel("time", f"reading of a {kind}", curves, "At rest", ("s", 1.0), display)


REST = Computed("rest", SIGNALS, identify)
