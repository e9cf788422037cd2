"""`harvester variants`, `parameters` and `signals`: lists of what the machine and a system contain."""

from __future__ import annotations

from typing import Annotated

from orchestrator.base.options import Kind, Swaps
from orchestrator.cli.options import BUILD, File, System, command, system_file


@command
def variants(
    system: System = None,
    cost: bool = False,
    combinations: bool = False,
    out: File = BUILD / "combinations.csv",
) -> bool:
    """List the variants of each part, with numbers of states and inputs, and the range of validity.

    system         System in which the cost of the variants is measured; default: build/harvester.ssp, else
                   the one in the installed package.
    cost           Also measure the simulation time of each variant on this computer, a few seconds.
    combinations   Run the work cycle with every combination of variants instead.
    out            With `combinations`: file for the table (.csv).
    """
    from fmus.machine.parts import FAMILIES
    from fmus.machine.tables import variant_lines, variant_names

    if not (cost or combinations):
        print("\n".join(variant_lines({})))
        print("To measure the cost of each variant on this computer: harvester variants --cost")
        return True
    from orchestrator.base.files import require_system
    from orchestrator.studies.variants import costs, table

    file = require_system(system_file(system))
    if combinations:
        joints = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
        return table(file, {part: list(family) for part, family in FAMILIES.items()}, joints, out)
    print("\n".join(variant_lines(costs(file, variant_names()))))
    return True


@command
def parameters(
    subsystem: Annotated[str | None, Kind(positional=True)] = None,
    source: Annotated[str | None, Kind("SOURCE")] = None,
) -> None:
    """Print the parameters of the model with value, unit and source.

    If FMUs in the folder build were built with other values, prints these and the shipped values.

    subsystem   A part or a variant of a part, such as swing or swing_detailed, or a part of the names of
                parameters, such as hose; default: the whole machine.
    source      Only parameters of this source: paper, derived, literature, assumed or identified; default:
                all.
    """
    from fmus.machine.tables import print_parameters

    print_parameters(subsystem, source, BUILD)


@command
def signals(
    system: System = None, kind: Annotated[str | None, Kind("KIND")] = None, swap: Swaps = None
) -> None:
    """List the variables of a system with unit and description.

    kind   Only this kind: input, output or parameter; default: all.
    """
    from orchestrator.base.files import require_system
    from orchestrator.ssp.listing import lines
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    print("\n".join(lines(with_swaps(load(require_system(system_file(system))), swap or {}), kind)))
