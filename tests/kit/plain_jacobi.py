"""A Jacobi master of its own, which shares no code with the engine but the calls into FMUs.

Tests of other tools compare with it, because they step like that; tests of the engine do.
"""

from functools import cache
from pathlib import Path

import numpy as np

from kit.work_cycle import SIGNALS
from orchestrator import System, load, run
from orchestrator.engine.network import initialise
from orchestrator.engine.run import open_slave

# the same algorithm on the same FMUs: only the times of the steps differ, by rounding, and with them the
# inner steps of the solvers; measured 5e-12 over 10 s, and 4e-10 where the run itself is unstable
SAME = 1e-8


def plain_jacobi(
    system: System, step: float, steps: int, record: list[str], every: int = 1, rounds: int = 1
) -> dict[str, np.ndarray]:
    """Real outputs at every `every`-th point. All FMUs take the same steps with inputs that are held.

    rounds   how often outputs are read, and inputs set, at a communication point: more than once where
             outputs depend on inputs directly
    """
    slaves = {name: open_slave(component) for name, component in system.components.items()}
    wires = [c for c in system.connections if system.variable(c.target).causality == "input"]
    wanted = dict.fromkeys([*(c.source for c in wires), *map(system.port, record)])
    values, place = np.zeros(len(wanted)), {}
    inputs, fed, calls = np.zeros(len(wires)), {}, ([], [])
    for name, slave in slaves.items():
        for ports, array, seen, make, into in (
            ([p for p in wanted if p.component == name], values, place, slave.reader, calls[0]),
            ([c.target for c in wires if c.target.component == name], inputs, fed, slave.writer, calls[1]),
        ):
            first = len(seen)
            seen.update({port: first + i for i, port in enumerate(ports)})
            if ports:
                into.append(make([p.variable for p in ports], array[first : first + len(ports)]))
    wires.sort(key=lambda c: fed[c.target])
    source = [place[c.source] for c in wires]
    factor, offset = (np.array([getattr(c.map, word) for c in wires]) for word in ("factor", "offset"))
    rows = []
    try:
        initialise(system, slaves, {}, (0.0, step * steps))
        for n in range(steps + 1):
            for slave in slaves.values() if n else ():
                slave.step((n - 1) * step, step)
            for _ in range(rounds):
                for read in calls[0]:
                    read()
                inputs[:] = values[source] * factor + offset
                for write in calls[1]:
                    write()
            if n % every == 0:
                rows.append([values[place[system.port(name)]] for name in record])
    finally:
        for slave in slaves.values():
            slave.close()
    return dict(zip(record, np.array(rows).T, strict=True))


@cache
def ours(
    folder: Path, step: float, stop: float, rates: bool = True, master: str = "plain"
) -> dict[str, np.ndarray]:
    """The work cycle with harvester.ssp of `folder`, or without its rate wires: SIGNALS every 20 ms."""
    system = load(folder / "harvester.ssp")
    if not rates:
        system = system.without("*_rate", "*_acceleration")
    if master == "plain":
        found = plain_jacobi(system, step, round(stop / step), list(SIGNALS), round(0.02 / step))
    else:
        found = run(system, master=master, step=step, stop=stop, record=SIGNALS, record_step=0.02).trace
    return {name: found[name][1:] for name in SIGNALS}
