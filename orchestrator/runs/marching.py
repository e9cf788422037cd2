"""Which of the two loops a run takes: the one in C, or the one in Python."""

from __future__ import annotations

from contextlib import suppress

from orchestrator.coupling.network import Network
from orchestrator.runs import native
from orchestrator.runs.compiled import Compiled
from orchestrator.runs.march import March
from orchestrator.runs.programs import Foreign


def marching(fast: bool, network: Network, *others: object) -> March:
    """A run that is ready to begin, in C if that is wanted and possible; `others` as in `March`."""
    library = native.library() if fast else None
    if fast and not isinstance(library, str):
        with suppress(Foreign):
            return Compiled(network, *others)  # type: ignore[arg-type]
    march = March(network, *others)  # type: ignore[arg-type]
    march.notes = (library,) if isinstance(library, str) else ()
    return march
