"""`harvester describe`: a first TOML file for a data file, with what is known of each column.

A column that has the name of a signal is described at once. The lines of the others are comments, in which
the user confirms or corrects name and unit.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from fmus.identification.recordings.masks import faults, noise, step, zeros_of_dead_zone
from fmus.identification.recordings.quality import examine
from fmus.identification.recordings.reading import CHOICES, CONDITIONS, MACHINE, MACHINE_SIGNALS, REST, TABLES
from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import write_whole
from orchestrator.base.signals import bare_name
from orchestrator.base.text import first_names
from orchestrator.base.units import COMMON, convert, is_unit, parse_unit, si_unit
from orchestrator.data.corrections import log_faults
from orchestrator.data.description import SignalDescription
from orchestrator.data.recording import Recording, Sensor
from orchestrator.data.table import Columns, TextFormat, clock, is_in_days, read_columns, time_axis
from orchestrator.data.trace import units_of_run

# SI unit -> what sensors of a machine measure, and the group of a quantity
SENSORS: Mapping[str, Sequence[str]] = {
    u: q["signals"] for u, q in TABLES["quantities"].items() if "signals" in q
}
GROUPS: Mapping[str, str] = {unit: q["group"] for unit, q in TABLES["quantities"].items() if "group" in q}
# A time without a unit is in the largest one in which a logger is faster [Hz]. It is in seconds if its steps
# are at most so long [s] and the log would else be shorter than any experiment [s]: 0, 1, 2 ... 60 are no ms.
SLOWEST, SPARSE, SHORTEST = 2.0, 10.0, 0.5
HEAD = """# Remove "# " in front of the signals that you need, and correct their names and units.
# What remains a comment is left out. `harvester signals` lists all names, docs/recordings.md all keys.

[file]
{}

[time]
column = {}
unit = {}

{}

{}

[signals]"""


def describe(data: Path, out: Path | None = None, procedure: str = "", force: bool = False) -> str:
    """Write the TOML file of a data file; returns what was found, for a terminal.

    out         the TOML file; default: with the name of the data
    procedure   that of the experiment, for `harvester identify`
    force       overwrite an existing file
    """
    out = out or data.with_suffix(".toml")
    if procedure and procedure not in CONDITIONS:
        raise Problem(f"--procedure: expected one of {', '.join(CONDITIONS)}, got {procedure!r}")
    if out.suffix != ".toml" or out.resolve().parent != data.resolve().parent:
        raise Problem(f"--out {out}: expected a file that ends in .toml, in the folder of {data}")
    file = toml.read_file(out) if out.exists() else toml.Table(str(out), {})
    if not file.data.keys() <= {"file"} and not force:
        raise Problem(f"{out}: expected no such file, got one; --force overwrites it, --out names another")
    form = replace(toml.read_dataclass(TextFormat, file.table("file")), csv=data.name)
    columns = read_columns(data, None, form, lenient=True)
    unread = list(columns.faults.values())
    of_run = units_of_run(data, columns.values)
    columns = replace(columns, units={**columns.units, **of_run})
    if len(columns.values) < 2 and unread:
        raise Problem(unread[0])
    units = {name: _unit(columns, name) for name in columns.values}
    time, units[time] = _time(columns, units)
    recorded = [name for name in columns.values if name not in (time, *columns.moments)]
    in_si = {name: si_unit(units[name]) for name in recorded}
    values = {n: convert(columns.values[n], units[n], unit, n) for n, unit in in_si.items()}
    # noise and resolution as the samples show them, so that only faults are remarked on
    shown = {n: Sensor(noise=float(np.nan_to_num(noise(v))), resolution=step(v)) for n, v in values.items()}
    seconds = time_axis(columns, time, units[time])
    every = float(np.median(np.diff(seconds))) if seconds.size > 1 else 0.0
    logged = {n: [*log_faults(columns.values[n], SignalDescription(units[n]), every)] for n in values}
    recording = Recording(seconds, values, in_si, Path(data.name), sensors=shown, faults=logged)
    quality = examine(recording)
    sensors = _sensors(procedure)
    dimensions, proposed = {parse_unit(unit).exponents for unit in sensors}, set[str]()
    lines = list[str]()
    for signal in quality.channels:
        column, unit = signal.signal, units[signal.signal]
        finite = columns.values[column][np.isfinite(columns.values[column])]
        extent = f"{finite.min():.6g} to {finite.max():.6g}" if finite.size else "no number"
        unused = faults(recording, column)
        causes = [f"{cause} {100 * mask.mean():.2g} %" for cause, mask in unused.items() if mask.any()]
        found = ", ".join([*causes, *["constant"] * (signal.low == signal.high)])
        names, may_be = ([column], "") if column in of_run else _candidates(column, unit, sensors)
        name = next((n for n in names if n not in proposed), "NAME")
        proposed.add(name)
        keys = f"column = {_text(column)}, unit = {_text(unit or '?')}"
        if unit and column not in of_run and parse_unit(unit).exponents not in dimensions:  # counts, mA, %
            keys = f'column = {_text(column)}, unit = "?", factor = 1.0, offset = 0.0'
        about = "; ".join(filter(None, (f"{column}: {extent} {unit or '?'}", found, may_be or names[0])))
        group = GROUPS.get(si_unit(unit), "")
        keys += f', group = "{group}"' * bool(group)
        factor = parse_unit(unit).factor
        # finer steps are digits of the file
        step_shown = shown[column].resolution * (shown[column].resolution > signal.noise / 10)
        zone = zeros_of_dead_zone(values[column], shown[column])
        shown_keys = {"dead_zone": zone, "noise": signal.noise, "resolution": step_shown}
        instrument = ", ".join(f"{k} = {v / factor:.3g}" for k, v in shown_keys.items() if v > 0)
        lines.append(
            f"# {about}\n{'# ' * bool(may_be or name == 'NAME')}{_text(name)} = {{ {keys} }}"
            f"{f'  # as the samples show: {instrument}' if instrument else ''}\n"
        )
    mark = "" if procedure else "# "
    experiment = f'{mark}[experiment]\n{mark}procedure = "{procedure or MACHINE}"'
    for name in CONDITIONS.get(procedure, ()):
        first, *others = map(_text, CHOICES.get(name, ["?"]))
        value = first if name in CHOICES else f"{{ value = ?, unit = {_text(TABLES['units'][name])} }}"
        experiment += f"\n# {name} = {value}{'  # or ' * bool(others)}{', '.join(others)}"
    formats = "\n".join(f"{key} = {_text(v)}" for key, v in vars(form).items() if v not in (None, ""))
    limits = ["# [tolerances]  # with which `harvester validate` judges, here of errors over the range"]
    groups = (g for g in GROUPS.values() if f'group = "{g}"' in "".join(lines))
    limits += [f'# {group} = {{ metric = "nrmse", limit = 0.1 }}' for group in groups]
    head = HEAD.format(formats, _text(time), _text(units[time]), experiment, "\n".join(limits))
    write_whole(out, "\n".join([head, *lines]))
    use = f"harvester identify {out.parent}" if procedure else f"harvester validate --reference {data}"
    told = [f"{data}: {len(columns.rows)} rows at {quality.rate:.6g} Hz, time in {time!r} [{units[time]}]"]
    told += [line.partition("\n")[0].removeprefix("# ") for line in lines]
    told += [f"{fault}; left out" for fault in unread]
    told += [*quality.remarks(), *recording.log_faults()]
    return "\n".join([*told, f"{out}: written; fill in the names of the signals, then: {use}"])


def _text(text: str | int) -> str:
    """A text or a number in TOML, which has the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False)


def _time(columns: Columns, units: Mapping[str, str]) -> tuple[str, str]:
    """The first column of increasing times, one with such a name before the others; its unit or a guess."""
    name = clock(columns)
    for moment in () if name else columns.moments:
        late = int((np.diff(columns.values[moment]) <= 0).argmax()) + 1
        expected = "expected increasing times, got one that is not later: a clock without milliseconds?"
        raise Problem(f"{columns.location(late)}: column {moment!r}: {expected}")
    increasing = (name for name, values in columns.values.items() if (np.diff(values) > 0).all())
    if not (name := name or next(increasing, "")):
        names = first_names(columns.values, 8)
        raise Problem(f"{columns.file}: expected a column of increasing times, got none among {names}")
    times = columns.values[name]
    step, length = float(np.median(np.diff(times))), float(times[-1] - times[0])
    fast = next((u for u in ("s", "ms", "us") if step * parse_unit(u).factor <= 1 / SLOWEST), "ns")
    guess = "s" if step <= SPARSE and length * parse_unit(fast).factor < SHORTEST else fast
    return name, "s" if columns.moments.get(name) else "d" if is_in_days(columns, name) else units[
        name
    ] or guess


def _unit(columns: Columns, name: str) -> str:
    """The unit in the file, or after the last underscore of the name; "" if unknown."""
    word = name.rpartition("_")[2]
    unit = columns.units.get(name) or (word if word in COMMON and len(word) > 1 else "")
    return unit if is_unit(unit) else ""


def _sensors(procedure: str) -> Mapping[str, Sequence[str]]:
    """SI unit -> signals that a procedure reads."""
    if procedure in ("", REST, *MACHINE_SIGNALS):  # validate knows only signals of the machine
        return {unit: names for unit, names in SENSORS.items() if procedure or unit != "K"}
    require("identify", f"harvester describe --procedure {procedure}")
    signals = import_module("fmus.identification.pipeline").PROCEDURES[procedure].signals
    return {unit: [name for name, u in signals.items() if u == unit] for unit in signals.values()}


def _candidates(column: str, unit: str, sensors: Mapping[str, Sequence[str]]) -> tuple[Sequence[str], str]:
    """The signals that a column may be by name and unit, and a text of them; "" if it is the only one."""
    groups = {u: n for u, n in sensors.items() if parse_unit(u).exponents == parse_unit(unit).exponents}
    names = [name for group in (groups or sensors).values() for name in group]
    if groups and (same := [n for n in names if column.lower() in (n.lower(), bare_name(n).lower())]):
        return same, ""
    words = {
        word for word, others in TABLES["words"].items() if re.search(f"{word}|{others}", column.lower())
    }
    score = {
        n: len(words & own) - len(words - own) / 2 for n in names for own in [{*bare_name(n).split("_")}]
    }
    best = max(score.values())
    if best > 0 or groups:
        names = [name for name in names if score[name] == best or best <= 0]
        return names, "" if groups and best > 0 and len(names) == 1 else first_names(names)
    return [], "anything"
