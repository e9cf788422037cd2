"""Keeps what the compiler made, so that a second build of the same code takes seconds.

The compiler has a cache of its own, but it knows a file by its place on the disk, not by what is in it.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path


@cache
def store() -> Path:
    """The folder of what is kept: in the cache of the compiler, so that who empties that empties this."""
    command = [sys.executable, "-m", "ziglang", "env"]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    found = re.search(r'global_cache_dir"?\s*[:=]\s*"([^"]+)"', told)  # JSON of old versions, ZON of new ones
    root = Path(found[1].replace("\\\\", "\\")) if found else Path.home() / ".cache"
    return root / "harvester-cosim"


def kept(ingredients: Iterable[bytes], make: Callable[[], bytes]) -> bytes:
    """What `make` makes of the ingredients, from the store if it is there."""
    digest = hashlib.sha256()
    for part in ingredients:
        digest.update(len(part).to_bytes(8, "big") + part)
    path = store() / digest.hexdigest()
    if path.is_file():
        return path.read_bytes()
    data = make()
    _keep(path, data)
    return data


def _keep(path: Path, data: bytes) -> None:
    """Write the whole file or none; a store that cannot be written to keeps nothing."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(data)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
