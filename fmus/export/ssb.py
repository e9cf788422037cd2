"""The signal dictionary of an SSP (SSB): every output, as a trace names it, with unit and text."""

from __future__ import annotations

from fmus.export.sspxml import REAL, add, root, text, units
from fmus.export.structure import Structure

NAME, FILE = "signals", "signals.ssb"


def signal_dictionary(s: Structure) -> bytes:
    """A file with one entry per output of a component."""
    element = root("ssb:SignalDictionary", s.version)
    for component, e in s.elements.items():
        for name in e.outputs:
            variable = e.variables[name]
            entry = add(
                element,
                "ssb:DictionaryEntry",
                name=f"{component}.{name}",
                description=variable.description or None,
            )
            add(entry, f"ssc:{REAL[s.version]}", unit=variable.unit)
    shown = {e.variables[name].unit for e in s.elements.values() for name in e.outputs}
    units(element, "ssb", [e.description for e in s.elements.values()], shown)
    return text(element)
