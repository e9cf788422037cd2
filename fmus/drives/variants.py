"""Models of the drives of a part by fidelity."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fmus.contract import Subsystem, family
from fmus.drives.compensated import COMPENSATED
from fmus.drives.detailed import detailed, lumps_of
from fmus.drives.drive import Additions, Axis, Fidelity, part
from fmus.drives.lumped import LUMPED
from fmus.drives.quasistatic import QUASISTATIC

Lumps = int | Mapping[str, int] | None


def fidelity(variant: str, lumps: Callable[[Axis], int] = lambda _: 1) -> Fidelity:
    """That of a variant; lumps: in each line of an axis of the detailed drives."""
    others = {"lumped": LUMPED, "quasistatic": QUASISTATIC, "compensated": COMPENSATED}
    return detailed(lumps) if variant == "detailed" else others[variant]


def variants(
    name: str,
    axes: Sequence[Axis],
    values: Path,
    texts: Mapping[str, tuple[str, str]],
    additions: Additions = (),
    lumps: Lumps = None,
) -> dict[str, Subsystem]:
    """Models by fidelity, with the values of a parameters.toml.

    texts       variant -> text and range of validity
    additions   of each axis
    lumps       of each line of the detailed drives, one number or by axis; default: as many as it needs below
                75 Hz
    """
    axes = [replace(axis, additions=additions) for axis in axes]
    by_axis = dict.fromkeys((axis.name for axis in axes), lumps) if isinstance(lumps, int) else lumps
    chosen = lumps_of(values) if by_axis is None else lambda axis: by_axis[axis.name]
    made = {
        variant: part(
            name,
            axes,
            fidelity(variant, chosen),
            text=text,
            validity=validity,
            values=values,
            stiff=variant != "quasistatic",
        )
        for variant, (text, validity) in texts.items()
    }
    return family(name, **made)
