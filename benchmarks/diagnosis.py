"""What the diagnosis finds on machines that it was not built on, and what it tells of healthy ones.

    python -m benchmarks.diagnosis [--reserved | --hours N | --long]

Needs `harvester build --faults --fmi 2 --out build/faults`. Plants are simulated once and stored
(`benchmarks.diagnosis_field`, which draws machines, operators, sensors and faults); each machine is learned
from 180 s of healthy work without payload. Seeds and styles of `--reserved` are looked at as seldom as
possible; docs/diagnosis.md has the counts. An alarm is a repair that is told in a recording without a fault,
or before it; these times are not counted, as they are of the same work as a healthy recording.

- three clocks from the first influence of a fault on a reading (20 bar, 0.05 rad/s, 0.02 rad against the same
  work without it): safety 0.3 s; function 20 s of work, in which the lever of its function is beyond its dead
  band, or any lever if it belongs to none; wear in its recording: 5 min, with `--long` 30 min
- repair: what is told first; sizes of leaks, seals and the return filter: whether the 95 % interval holds
- least size: the smallest from which on half of those that are as large or larger are named
- payload: 5 s after each change, within max(5 kg, 1 %)
"""

from __future__ import annotations

import argparse
import math
from collections import Counter, defaultdict, namedtuple
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks import diagnosis_field as field
from benchmarks.diagnosis_field import BEGIN, LANES, PERIOD, VARIANTS, Case, Columns
from fmus.components.oil import viscosity_ratio
from fmus.machine.parts import feric
from fmus.machine.ssp import section_flows
from orchestrator.results.diagnosis import INTERVAL, Diagnosis, learned_values, over

SAFE, WORKED = 0.3, 20.0  # s after the first influence; s of work
LATEST = BEGIN - 0.1  # s: what is told may be told two rows of a log of 20 Hz early, as rows are held
HOT = 348.0  # K, above which an alarm of the cooler is true
EMPTY = 4e7  # Pa.s/m3, resistance of the return line with a new filter
BEFORE, QUIET = "before a fault", "healthy"  # the same work as with faults, without one
NAMES = [f"{v.get('boom_stick', 'lumped')}, {v['supply']}" for v in VARIANTS]


Alarm = namedtuple("Alarm", "kind seed style repair finding time")
# error [kg], whether it and its interval are within their bars
Weighed = namedtuple("Weighed", "kind style steep error within holds")
# repair that is told first; whether there is an influence; s and s of work from it until the right repair;
# size [SI, L/min at 100 bar of leaks], whether its interval holds it (None: it has none)
Outcome = namedtuple("Outcome", "kind seed rate case first seen after worked size holds")
Examined = tuple[dict[str, float], list[Alarm], list[Outcome], list[Weighed]]  # the first: h by style


def in_time(o: Outcome) -> bool:
    """By its clock."""
    in_work = o.case.clock != "function" or o.worked <= WORKED
    return bool(o.after < np.inf and in_work and (o.case.clock != "safety" or o.after <= SAFE))


def rights(case: Case) -> tuple[str, ...]:
    """Repairs that are right: also the one sensor of all "pressure sensors" that is wrong."""
    return (case.repair, f"{case.fault.replace('_', ' ')} sensor")


def told(fmu: Path, columns: Columns, swap: dict[str, str], healthy: dict[str, float]) -> Diagnosis:
    """What the FMU tells."""
    known, own = feric(faults=True), dict[str, float]()
    if swap.get("boom_stick") == "compensated":
        own = section_flows(known, known.diagnosis)
    signals = {n: v for n, v in columns.items() if n != "time"}
    return over(fmu, columns["time"], signals, set=own | healthy)


def repairs(found: Diagnosis, truth: Columns) -> dict[str, tuple[float, str]]:
    """Told repairs: since when [s], and by which finding; not that of oil which is hot."""
    first = dict[str, tuple[float, str]]()
    for f in found.findings:
        hottest = truth["oil_temperature"][: round(f.since / PERIOD) + 2].max() if f.broken else 0.0
        if f.broken and not (f.repair == "cooler" and hottest > HOT):
            first[f.repair] = min(first.get(f.repair, (np.inf, "")), (f.since, f.name))
    return first


def examined(job: tuple[int, range, int], fmu: Path, styles: Sequence[str], what: Sequence[str]) -> Examined:
    """A machine: its kind, the seeds of its group, and its place in it; `what` are its files."""
    kind, seeds, lane = job
    seed = field.machine_seeds(seeds, kind)[lane]
    swap, given = field.of_machine(seed)
    steep = math.hypot(*(given[f"manipulator.base_{n}"] for n in ("pitch", "roll"))) > math.radians(1)
    stored = dict[str, Columns]()
    for name in what:  # wear of the last file is the longest
        stored |= field.recordings(field.plants(seeds, kind, name), lane)
    if "learned" not in stored:  # its engine does not turn the pumps with oil that is so cold
        return {}, [], [], []
    healthy = learned_values(told(fmu, field.sensed(stored["learned"], seed), swap, {}))
    hours, alarms, payloads = dict[str, float](), list[Alarm](), list[Weighed]()
    for style, truth in ((s, stored[s]) for s in (*styles, QUIET) if s in stored):
        found = told(fmu, field.sensed(truth, seed), swap, healthy)
        hours[style] = PERIOD * len(truth["boom_angle"]) / 3600
        alarms += [Alarm(kind, seed, style, r, n, t) for r, (t, n) in repairs(found, truth).items()]
        payloads += weighed(truth, found, (kind, style, steep)) if style != QUIET else []
    early = {a.repair for a in alarms if a.style == QUIET and a.time < LATEST}
    outcomes = list[Outcome]()
    told_before = set(early)
    for k, case in enumerate(field.cases(seed)):
        name = QUIET if case.does else str(k)
        if name not in stored or QUIET not in stored:
            continue
        truth, readings = stored[name], field.sensed(stored[name], seed, case, part=1 + k)
        found = told(fmu, readings, swap, healthy)
        some = repairs(found, truth)
        before = {r: at for r, at in some.items() if at[0] < LATEST and r not in told_before}
        told_before |= before.keys()
        alarms += [Alarm(kind, seed, BEFORE, r, n, t) for r, (t, n) in before.items()]
        late = {r: t for r, (t, _) in some.items() if t >= LATEST}
        first = min(late, key=lambda r: late[r]) if late else "nothing"
        seen = field.influence(case, truth, stored[QUIET])
        named = min(late.get(r, np.inf) for r in rights(case))
        worked = field.work_until(case, truth, given)
        at, since = (min(round(min(t, 1e6) / PERIOD), len(worked) - 1) for t in (named, seen))
        size, holds = sized(case, found, truth["oil_temperature"])
        times = named - min(seen, named), float(worked[at] - worked[since]) if named < np.inf else np.inf
        rate = round(1 / readings["time"][1])
        outcomes.append(Outcome(kind, seed, rate, case, first, seen < np.inf, *times, size, holds))
    return hours, alarms, outcomes, payloads


def sized(case: Case, found: Diagnosis, temperature: field.Column) -> tuple[float, bool | None]:
    """Size of a fault at the begin, and whether the 95 % interval at the end holds it; None: it has none."""
    size, shown, name = case.size, abs(case.size), case.fault
    if name.endswith("seal_leakage"):
        begin, size = (case.size / float(viscosity_ratio(float(t))) for t in temperature[[0, -1]])
        shown = begin * 1e7 / field.LITRE
    elif "leak" in name:
        shown = size * field.JET / field.LITRE
    elif name == "filter_clogging":
        name, size = "return_resistance", size + EMPTY
    f = next((f for f in found.findings if f.name == name and f.unit != "1" and f.state[-1] > 0), None)
    return shown, None if f is None else bool(abs(f.size[-1] - size) < INTERVAL * f.deviation[-1])


def weighed(truth: Columns, found: Diagnosis, of: tuple[int, str, bool]) -> list[Weighed]:
    """Payloads 5 s after each change."""
    mass, result, after = truth["held_mass"], list[Weighed](), round(5 / PERIOD)
    moved = np.flatnonzero(np.abs(np.diff(mass)) > 0.5)
    at = np.asarray(found.result.time)
    size, off = (np.asarray(found.result[f"payload{end}"]) for end in ("", "_deviation"))
    for k, end in zip(moved + after, [*moved[1:], len(mass)], strict=False):
        if k < end:
            i = min(int(np.searchsorted(at, k * PERIOD)), len(at) - 1)
            error = float(abs(size[i] - mass[k]))
            holds = bool(error <= INTERVAL * off[i])
            result.append(Weighed(*of, error, bool(error <= max(5.0, 0.01 * mass[k])), holds))
    return result


def share(values: Iterable[bool], least: float = 0.0, most: float = 1.0) -> str:
    """As a percentage of a number, with its bar."""
    if not (some := list(values)):
        return "none"
    part, ends = np.mean(some), (("at least", least), ("at most", most))
    bar = ", ".join(f"{name} {end:.0%}" for name, end in ends if 0 < end < 1)
    met = f" ({bar}: {'met' if least <= part <= most else 'missed'})" if bar else ""
    return f"{part:.0%} of {len(some)}{met}"


def print_alarms(hours: Sequence[tuple[int, str, float]], alarms: Sequence[Alarm]) -> None:
    """By style, by kind, each of them, and what the rate is below."""
    print("\nalarms without a fault")
    keys: list[Any] = [*dict.fromkeys(s for _, s, _ in hours), BEFORE, *dict.fromkeys(k for k, *_ in hours)]
    for key in keys:
        count, time = sum(key in a[:3:2] for a in alarms), sum(h for *of, h in hours if key in of)
        print(f"  {key if isinstance(key, str) else NAMES[key]:28}{count:4} in {time:6.2f} h")
    total = sum(h for *_, h in hours)
    least = total / (chi2.ppf(0.95, 2 * len(alarms) + 2) / 2)  # of Poisson's distribution
    print(f"  {'all':28}{len(alarms):4} in {total:6.2f} h; fewer than one in {least:.2g} h", end=" ")
    print(f"with 95 % confidence (500 h: {'met' if least >= 500 else 'missed'})")
    for a in alarms:
        print(f"    kind {a.kind}, seed {a.seed}, {a.style}: {a.repair}, {a.finding} at {a.time:.1f} s")


def print_clocks(outcomes: Sequence[Outcome], wear: str) -> None:
    """In time and at all, by repair and by rate of the log."""
    seen = [o for o in outcomes if o.seen]
    safety = [o for o in seen if o.case.clock == "safety"]
    print(f"\n{len(outcomes)} faults; {len(outcomes) - len(seen)} have no influence, so no clock")
    for name, least, own in (
        (f"safety, hoses, spools, drivers, {SAFE:g} s", 0.95, [o for o in safety if not o.case.does]),
        (f"safety, readings, {SAFE:g} s", 0.95, [o for o in safety if o.case.does]),
        (f"function, {WORKED:g} s of work", 0.85, [o for o in seen if o.case.clock == "function"]),
        (f"wear, {wear}", 0.87, [o for o in seen if o.case.clock == "wear"]),
    ):
        groups = defaultdict[str, list[Outcome]](list)
        for o in own:
            groups[o.case.repair.split()[-1]].append(o)
            groups[f"{o.rate:3} Hz"].append(o)
        at_all = share(o.after < np.inf for o in own)
        print(f"{name}: {share((in_time(o) for o in own), least)}; at all {at_all}")
        for n, some in sorted(groups.items()):
            at_all = share(o.after < np.inf for o in some)
            print(f"    {n:10} {share(in_time(o) for o in some):12} at all {at_all}")


def print_repairs(outcomes: Sequence[Outcome]) -> None:
    """What is told first, sizes, and the least ones that are found."""
    right = [o.first in rights(o.case) for o in outcomes if o.first != "nothing"]
    other = [o.first.endswith(("pump", "valve")) for o in outcomes if o.case.does]
    print(f"\nrepair right in what is told first: {share(right, 0.95)}")
    print(f"sensors told as pump or valve: {share(other, most=0.03)}")
    print(f"95 % intervals of sizes hold: {share((o.holds for o in outcomes if o.holds is not None), 0.9)}")
    table, sizes = defaultdict[str, Counter[str]](Counter), defaultdict[str, list[tuple[float, bool]]](list)
    for o in outcomes:
        first, c = "right" if o.first in rights(o.case) else o.first, o.case
        table[c.repair.split()[-1]][first] += 1
        if c.does == "off" or not (c.does or c.clock == "safety"):
            name = "pressure" if c.fault in field.PRESSURES else c.fault.removeprefix(f"{c.part}_")
            sizes[f"{name} {c.does}, {NAMES[o.kind]}"].append((o.size, o.after < np.inf))
    print("\nconfusion by repair: what is told first")
    for repair, row in sorted(table.items()):
        print(f"  {repair:10} {', '.join(f'{n} {k}' for n, k in row.most_common())}")
    print("\nleast size [SI, leaks: L/min at 100 bar] of which half of the larger are named, of how many")
    for name, rows in sorted(sizes.items()):
        rows.sort()
        good = [s for k, (s, _) in enumerate(rows) if np.mean([f for _, f in rows[k:]]) >= 0.5]
        ends = f"{len(rows)}, {rows[0][0]:.3g} to {rows[-1][0]:.3g}"
        print(f"  {name:50} {f'{good[0]:.3g}' if good else 'none':>9}  of {ends}")


def print_payloads(payloads: Sequence[Weighed]) -> None:
    """By head, work and slope."""
    print("\npayload 5 s after a change, within max(5 kg, 1 %)")
    for head, level, sloping in (("rigid", 0.9, 0.9), ("hanging", 0.75, 0.6)):
        own = [w for w in payloads if ("manipulator" in VARIANTS[w.kind]) == (head == "hanging")]
        for work, least, some in (
            ("all", level, own),
            ("not slewing", level, [w for w in own if w.style != "slewing"]),
            ("slewing", level, [w for w in own if w.style == "slewing"]),
            ("slope above 1 degree", sloping, [w for w in own if w.steep]),
        ):
            half = f"; half within {np.median([w.error for w in some]):.1f} kg" if some else ""
            print(f"  {f'{head}, {work}':30} {share((w.within for w in some), least)}{half}")
        print(f"  {f'{head}, intervals hold':30} {share((w.holds for w in own), 0.9, 0.99)}")
    print(f"  {'all':30} {share(w.within for w in payloads)}")


def main() -> None:
    """Examine the machines and print each bar."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--reserved", action="store_true", help="the other seeds, and the styles kept back")
    parser.add_argument("--hours", type=float, default=0.0, help="alarms only, on further open machines")
    parser.add_argument("--long", action="store_true", help="wear for 30 min")
    parser.add_argument("--no-faults", action="store_true")
    parser.add_argument("--machines", type=int, default=LANES, help="of each kind")
    parser.add_argument("--kinds", type=int, nargs="*", default=list(range(len(VARIANTS))))
    parser.add_argument("--fmu", type=Path, default=field.PARTS / "diagnosis.fmu")
    parser.add_argument("--verbose", action="store_true", help="print each fault")
    given, begin = parser.parse_args(), perf_counter()
    if not given.fmu.exists():
        raise SystemExit(f"{given.fmu}: no such file; harvester build --faults --fmi 2 --out {field.PARTS}")
    seeds, styles = (field.KEPT, field.STYLES) if given.reserved else (field.SEEDS, field.OPEN)
    groups, what = [seeds], ["work", *["faults"][given.no_faults :], *["long"][: given.long]]
    if given.hours:
        an_hour = 3600 / (
            min(LANES, given.machines) * len(field.OPEN) * field.LONGER * len(given.kinds)
        )  # groups
        count, what = math.ceil(given.hours * an_hour), ["further"]
        groups = [range(seeds.stop + LANES * k, seeds.stop + LANES * (k + 1)) for k in range(count + 1)]
        groups = [g for g in groups if g != field.KEPT][:count]
    for kind, group, name in product(given.kinds, groups, what):
        field.plants(group, kind, name)
    jobs = list(product(given.kinds, groups, range(min(LANES, given.machines))))
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(partial(examined, fmu=given.fmu, styles=styles, what=what), jobs))
    outcomes = [o for one in found for o in one[2]]
    for o in outcomes if given.verbose else []:
        print(*(f"{v:.3g}" if isinstance(v, float) else v for v in o))
    kept = "reserved" if given.reserved else "open"
    done = f"{sum(bool(one[0]) for one in found)} of {len(jobs)} machines could be simulated"
    print(f"{done}, {kept} seeds from {groups[0][0]}")
    hours = [(kind, s, h) for (kind, *_), one in zip(jobs, found, strict=True) for s, h in one[0].items()]
    print_alarms(hours, [a for one in found for a in one[1]])
    if outcomes:
        print_clocks(outcomes, "30 min" if given.long else "5 min")
        print_repairs(outcomes)
    print_payloads([w for one in found for w in one[3]])
    print(f"{perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
