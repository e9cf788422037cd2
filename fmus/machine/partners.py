"""Which ports of the machine's FMUs belong together: for the page of each FMU and for the release."""

from collections.abc import Iterator
from dataclasses import replace

from fmus.contract import Subsystem, quantities
from fmus.machine.parts import ALL, COMMAND_WIRES, CONNECTIONS, CONTROL_WIRES, SUBSYSTEMS, SUPPLY_WIRES
from fmus.machine.ssp import NAME
from fmus.supply import SUPPLY

WIRES = CONNECTIONS + COMMAND_WIRES + SUPPLY_WIRES + CONTROL_WIRES
RATES = {name: q.rate for sub in ALL.values() for name, q in quantities(sub.inputs).items() if q.rate}
UNPOWERED = (
    "While supply_pressure is 0, no command turns the swing, and each command lets boom or stick sink."
)
HELD = (
    "What held inputs cost, as the error of the worst joint speed over 42 s in Ecos, a Jacobi master: with "
    "rate ports 0.0086 % at a step of 1 ms; without them 0.072 % at 0.1 ms, and at 1 ms the run diverges. "
    "Measured by “python docs/rate_ports.py” in the repository of harvester-cosim."
)
HELD_COMMAND = (
    "What a held command costs with an open rate port, as the error of what moves: 0.34 % if the command is "
    "set every 1 ms, 3.2 % if every 10 ms. Measured by “make matrix” in the repository of harvester-cosim."
)


def wired_ports() -> Iterator[tuple[str, str, str, str, str]]:
    """FMU, port, other FMU, its port, the rate port in both; without ports that are only rates."""
    for start, end in WIRES:
        (source, output), (target, name) = start.split("."), end.split(".")
        rate = RATES.get(name, "")
        wired = (f"{source}.{rate}", f"{target}.{rate}") in WIRES
        if name in RATES or name not in RATES.values():
            yield source, output, target, name, rate if wired else ""


def with_partners(sub: Subsystem) -> Subsystem:
    """The subsystem with its connections to other FMUs of the machine."""
    own = SUBSYSTEMS if sub.component == NAME else (sub.component,)
    ends: dict[str, tuple[list[str], set[str]]] = {}
    for source, output, target, name, rate in wired_ports():
        for part, port, other, its in ((source, output, target, name), (target, name, source, output)):
            # the supply needs the flow into each drive, which the machine in one FMU does not have
            if part in own and other not in own and (sub.component, other) != (NAME, SUPPLY.name):
                others, rates = ends.setdefault(port, ([], set()))
                others.append(other if its == port else f"{other}.{its}")
                rates.add(rate)
    rows = [(port, tuple(others), max(rates)) for port, (others, rates) in ends.items()]
    held = {**dict.fromkeys(SUBSYSTEMS, (HELD,)), NAME: (HELD_COMMAND,)}.get(sub.component, ())
    notes = (UNPOWERED, *held) if held and "supply_pressure" in quantities(sub.inputs) else held
    return replace(sub, connections=tuple(rows), notes=notes)


def connection_list() -> str:
    """All connections of the parts as plain text."""
    return "\n".join(
        f"  {source}.{output} to {target}.{name}{rate and ', rate port '}{rate}"
        for source, output, target, name, rate in wired_ports()
    )
