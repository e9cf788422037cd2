"""Where the FMU lies: folders with spaces and other letters, and the forms of the resource location."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

from orchestrator.trial.bench import Bench, Said
from orchestrator.trial.binary import Refused
from orchestrator.trial.player import bits

ODD = "mit Leerzeichen # äß 林"
LARGE = 100e6  # bytes: a copy would take long


def resources(bench: Bench) -> Iterator[Said]:
    """The first values do not depend on the folder, nor on how its location is written."""
    if sum(p.stat().st_size for p in bench.folder.rglob("*") if p.is_file()) > LARGE:
        return
    plain = bench.player().begin()
    expected = [plain.row()]
    folder = Path.cwd() / ODD  # in the folder of the job, which the parent removes whatever happens here
    shutil.copytree(bench.folder, folder)
    (folder / "resources").mkdir(exist_ok=True)
    bench.folder = folder
    binary = bench.load(folder)
    for location, severity in _forms(bench.declared.major, folder / "resources"):
        case = f'with the resources at "{_shown(location, folder)}" in a folder "{ODD}"'
        bench.beacon.inputs(f"({case})")
        try:
            player = bench.player(binary=binary, resources=location).begin()
            row = [player.row()]
            player.close()
        except Refused as refusal:
            yield severity, f"{case}: {refusal}"
            continue
        if bits(row) != bits(expected):
            yield severity, f"{case} the first outputs differ"


def _shown(location: str, folder: Path) -> str:
    """A location without the path of the temporary folder."""
    uri = folder.as_uri()
    location = location.replace(uri, "file:///FOLDER")
    return location.replace(uri.replace("file:///", "file:/"), "file:/FOLDER").replace(str(folder), "FOLDER")


def _forms(major: int, there: Path) -> list[tuple[str, str]]:
    """Ways to write the location, the usual one first, and how bad it is when it does not work."""
    if major == 3:  # the standard wants a separator at the end
        return [(f"{there}/", "error"), (str(there), "note")]
    uri = there.as_uri()
    return [(uri, "error"), (f"{uri}/", "warning"), (uri.replace("file:///", "file:/"), "warning")]
