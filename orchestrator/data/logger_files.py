"""Reads the files of loggers: MDF 4 (.mf4) by asammdf, TDMS by npTDMS, headers of LabVIEW (.lvm).

Other formats are refused by name.

The groups of such a file have clocks of their own. All are read on one clock, the column `time` [s]: that of
the group with the most samples. A sample of a slower group is at the nearest of these times, between gaps.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import Location, tell_once
from orchestrator.base.interrupts import time_limit
from orchestrator.base.numerals import finite
from orchestrator.base.processes import FLOAT64
from orchestrator.base.text import first_names
from orchestrator.base.units import parse_unit
from orchestrator.data.matlab import MAX_BYTES, check_size, foreign

Array = NDArray[np.float64]
HEAD = 512  # bytes that show the format of a file
PATIENCE, FOR_A_BYTE = 3.0, 5e-6  # [s], [s/byte]: processor time for a file, whose blocks may be a loop
TIME, SECOND = "time", np.timedelta64(1, "s")
DENSE = 1.5  # periods of a clock; samples that are closer have no gap in between
ROUNDING = 1e-6  # of times, in periods
CLOCK = re.compile(  # names of columns of times
    r"t$|(?-i:t)(_[mun]?s)?(\s*[\[(].*)?$|x_value|.*(time|zeit|uhr|stamp|datum|\bdate\b)", re.IGNORECASE
)
LABVIEW, END_OF_HEADER = "LabVIEW Measurement", "***End_of_Header***"
MDF, TDMS = "an MF4", "a TDMS"
READ = {b"MDF     4": MDF, b"UnFinMF ": MDF, b"TDSm": TDMS}  # beginning of a file -> its format
DECODE, EXPORT, SHEET = (
    "decode it with the DBC file, and export MF4 or CSV",
    "export its topics as CSV, such as by PlotJuggler",
    "save the sheet as CSV",
)
PIVOT = "pivot it to one column for each signal, such as by pandas.DataFrame.pivot, and export CSV"
OTHERS = {  # beginning of a file -> its format, and the way out
    rb"MDF     [^4]": ("MDF 3", "save it as MDF 4, such as by asammdf"),
    rb"\x89MCAP0": ("MCAP", EXPORT),
    rb"#ROSBAG|SQLite format 3": ("a ROS bag", EXPORT),
    rb"LOGG.\0\0\0|date \w{3} [^\n]*\n\s*base ": ("BLF or ASC (Vector)", DECODE),
    rb"\s*(\(\d+\.\d+\)\s+)?v?can\w*\s+[0-9A-Fa-f]{3,8}(#|\s+\[)": ("candump", DECODE),
    rb";\$FILEVERSION": ("a PCAN trace", DECODE),
    rb"PK\x03\x04.*(\[Content_Types\]|xl/)|\xd0\xcf\x11\xe0": ("Excel", SHEET),
    rb"PK\x03\x04|\x1f\x8b|BZh\d1AY|7z\xbc\xaf|\xfd7zXZ|\x28\xb5\x2f\xfd": ("an archive", "unpack it"),
    rb"\x89PNG|\xff\xd8\xff|GIF8[79]a|%PDF": ("a picture or a PDF", "export its values as CSV"),
    rb"PAR1[\0-\x1f]": ("Parquet", "name it .parquet"),
    rb"DIAEXTENDED|.{,3}<\?xml.*<\w*:?tdm\b": ("a header of DIAdem", "export its channels as TDMS or CSV"),
    rb"\s*[\[{]\s*[\[{\"]": ("JSON", "write its signals to CSV, such as by pandas.json_normalize"),
    rb"[\w.-]+(,[^\s=]+=\S+)? [^\s=]+=\S+ -?\d+\s": ("Influx line protocol", PIVOT),
    rb"\x89HDF|MATLAB 5": ("MATLAB or HDF5", "name it .mat, or export CSV"),
}


MODELS = {".ssp": "a system", ".ssd": "a system", ".fmu": "an FMU"}  # which have no samples

# times [s] (None: unknown), samples and unit of a channel
Samples: TypeAlias = tuple[Array | None, NDArray[Any], str]


def logger_format(file: Location) -> str:
    """`MDF`, `TDMS`, or "" for a text; raises Problem for any other format, with the way out."""
    if kind := MODELS.get(Path(str(file)).suffix.lower()):
        raise Problem(f"{file}: expected a table, it is {kind}; harvester run makes a result of it")
    with file.opened() as opened:
        head = opened.read(HEAD)
    for begin, (name, advice) in OTHERS.items():
        if re.match(begin, head, re.DOTALL):
            raise Problem(f"{file}: expected a text (CSV), MF4 or TDMS file, got {name}: {advice}")
    return next((kind for begin, kind in READ.items() if head.startswith(begin)), "")


def labview_table(file: Location, text: str) -> str:
    """The table of a LabVIEW measurement file in its lines, with units in the names; another text as it is.

    Times may follow from the header. Comments and further columns of the same times are left out.
    """
    if not text.startswith(LABVIEW):
        return text
    *headers, table = text.split(END_OF_HEADER)
    if len(headers) != 2:
        raise Problem(f"{file}: expected one header of channels, got {len(headers) - 1}: use a file for each")
    mark = "," if "\nSeparator," in headers[0] else "\t"
    entries = {key: values for key, *values in (row.split(mark) for row in "".join(headers).splitlines())}
    try:
        steps = [step for step in entries["Delta_X"] if step.strip()]
        start, every = (finite(n.replace(",", ".")) for n in (entries["X0"][0], steps[0]))
        _, names, *rows = (line.split(mark) for line in table.splitlines())
    except (LookupError, ValueError):
        raise Problem(f"{file}: expected a LabVIEW file, got one without X0, Delta_X or names") from None
    if {*steps} != {steps[0]}:
        raise Problem(f"{file}: expected one Delta_X, got {first_names(steps)}: use a file for each")
    units = ["s", *entries.get("Y_Unit_Label", ()), *[""] * len(names)]
    kept = [k for k, n in enumerate(names) if n not in ("", "Comment") and (n != "X_Value" or not k)]
    lines = [mark.join(f"{names[k]} [{units[k]}]" if units[k] else names[k] for k in kept)]
    for k, row in enumerate(rows):
        time = row[0] or f"{start + k * every:.12g}".replace(".", "," if "," in steps[0] else ".")
        lines.append(mark.join([time, *(row[i] for i in kept[1:] if i < len(row))]) if any(row) else "")
    return "\n".join([""] * (sum(header.count("\n") for header in headers) + 1) + lines)


@contextmanager
def channels(file: Location, kind: str) -> Iterator[dict[str, Callable[[], Samples]]]:
    """Functions that read the channels, by name: "group.name" if several groups have the name."""
    library, open_file = ("asammdf", _mdf) if kind == MDF else ("nptdms", _tdms)
    require("logger", f"{file}: {kind} file", library)
    import_module(library)  # before the time counts
    patience = time_limit(PATIENCE + FOR_A_BYTE * file.path.stat().st_size)
    with foreign(file, kind), patience, open_file(file) as found:
        if found and all(name.startswith("CAN_DataFrame") for _, name, _ in found):
            advice = "decode them with the DBC file, such as by asammdf"
            raise Problem(f"{file}: expected signals, got frames of a CAN bus: {advice}")
        counts = Counter([TIME, *(name for _, name, _ in found)])
        yield {n if counts[n] == 1 else f"{group}.{n}": read for group, n, read in found}


def on_one_clock(
    file: Location, chosen: Mapping[str, Callable[[], Samples]], only_numbers: bool
) -> tuple[dict[str, Array], dict[str, str]]:
    """Samples and units of channels on the clock `time`.

    only_numbers   leave out the channels of texts and arrays; else they are refused
    """
    values, times, units = dict[str, Array](), dict[str, Array](), dict[str, str]()
    for name, read in chosen.items():
        time, samples, unit = read()
        if samples.ndim != 1 or samples.dtype.kind not in "fiub":
            if only_numbers:
                continue
            raise Problem(f"{file}: column {name!r}: expected numbers, got {samples.dtype}")
        values[name] = samples.astype(np.float64)
        units |= {name: unit} if unit else {}
        times |= {} if time is None else {name: time}
    if not times:
        return values, units
    clock = max(times.values(), key=len)
    units[TIME] = "s"
    return {TIME: clock, **{n: at_times(clock, times[n], v) for n, v in values.items() if n in times}}, units


@contextmanager
def _mdf(file: Location) -> Iterator[list[tuple[str, str, Callable[[], Samples]]]]:
    """Channels of an MDF 4 file: group, name, and what reads it; times since the start of the measurement."""
    import asammdf
    from asammdf.blocks import mdf_v4

    if "__del__" in vars(mdf_v4.MDF4):  # it prints a traceback if the file is damaged
        del mdf_v4.MDF4.__del__
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    opened = asammdf.MDF(BytesIO(file.read(MAX_BYTES)))

    def read(group: int, index: int) -> Samples:
        # numbers in place of the texts of an enumeration, without samples marked as invalid
        (signal,) = opened.select([(None, group, index)], ignore_value2text_conversions=True, validate=True)
        return signal.timestamps, signal.samples, signal.unit

    with opened:
        cells = sum(group.channel_group.cycles_nr * len(group.channels) for group in opened.groups)
        check_size(file, FLOAT64 * cells, "channels", file.path.stat().st_size)
        yield [
            (group.channel_group.acq_name or f"group {i + 1}", channel.name, partial(read, i, j))
            for i, group in enumerate(opened.groups)
            for j, channel in enumerate(group.channels)
            if j != opened.masters_db.get(i)
        ]


@contextmanager
def _tdms(file: Location) -> Iterator[list[tuple[str, str, Callable[[], Samples]]]]:
    """Channels of a TDMS file: group, name, and what reads it.

    Times are those of the waveform since the first start, or of the group's channel of times. If the end of
    the file is missing, the other channels of a group have the rows of the shortest one.
    """
    import nptdms
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)
    with nptdms.TdmsFile.open(BytesIO(file.read(MAX_BYTES))) as opened:
        found = [channel for group in opened.groups() for channel in group.channels()]
        check_size(file, FLOAT64 * sum(map(len, found)), "channels", file.path.stat().st_size)
        rows = dict[str, int]()
        if opened.file_status.incomplete_final_segment:
            tell_once(f"{file}: the end is cut off; read up to there")
            found = [channel for channel in found if len(channel)]
            for channel in found:
                rows[channel.group_name] = min(len(channel), rows.get(channel.group_name, MAX_BYTES))
        clocks = {c.group_name: c for c in found if c.dtype.kind == "M" or CLOCK.match(c.name)}
        starts = [c.properties["wf_start_time"] for c in found if "wf_start_time" in c.properties]
        first = min(starts, default=None)

        def read(channel: Any) -> Samples:
            about, clock, time = channel.properties, clocks.get(channel.group_name), None
            most = rows.get(channel.group_name)  # None: all
            if "wf_increment" in about:
                late = (about.get("wf_start_time", first) - first) / SECOND if starts else 0.0
                time, most = channel.time_track() + late, None
            elif clock is not None and clock.dtype.kind == "M":
                time = (clock[:most] - clock[0]) / SECOND
            elif clock is not None:
                time = parse_unit(clock.properties.get("unit_string", "s")).factor * clock[:most]
            samples = channel[:most]
            if time is not None and len(time) != len(samples):
                got = f"{len(time)} times, {channel.name} {len(samples)}"
                raise Problem(f"{file}: expected columns of one length, got {got}")
            return time, samples, str(about.get("unit_string", ""))

        yield [(channel.group_name, channel.name, partial(read, channel)) for channel in found]


def at_times(clock: Array, time: Array, values: Array) -> Array:
    """A signal that was sampled at its own times, on another clock; linear between two samples.

    Where its samples are farther apart than those of the clock, each is at the nearest time, and gaps follow.
    """
    if np.array_equal(clock, time):
        return values
    used = np.isfinite(values) & (np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0)
    time, values = time[used], values[used]
    if not time.size:
        return np.full(len(clock), np.nan)
    last = len(time) - 1
    next_one = np.clip(np.searchsorted(time, clock), min(1, last), last)
    before, after = time[np.maximum(next_one - 1, 0)], time[next_one]
    period = float(np.median(np.diff(clock)))
    inside = (clock >= time[0] - ROUNDING * period) & (clock <= time[-1] + ROUNDING * period)
    near = inside & (np.minimum(np.abs(clock - before), np.abs(clock - after)) <= period / 2 * (1 + ROUNDING))
    dense = inside & (after - before <= DENSE * period)
    return np.where(near | dense, np.interp(clock, time, values), np.nan)
