"""The first lines that run in Python, held by the library itself: they find the FMU's own script."""

import importlib.util
import os
import pathlib
import site
import sys
import threading
import urllib.parse
import urllib.request
from typing import Any

ERROR = 3
# These lines run for every instance, in one module: the lock is that of the first. Without it a thread would
# find the half of a script that another one is loading.
LOCK = globals().setdefault("LOCK", threading.RLock())


def start(*given: bytes) -> tuple[int, bytes, Any]:
    """Status, messages and what answers the calls of a new instance; raises nothing but interrupts."""
    try:
        name, guid, where, logging = (value.decode() for value in given)
        folder = find(where)
        own = os.environ.get("VIRTUAL_ENV")  # of a program that was started from an activated environment
        if own and importlib.util.find_spec("fmus") is None:
            for packages in ("lib/python{0}.{1}/site-packages", "Lib/site-packages"):
                site.addsitedir(str(pathlib.Path(own, packages.format(*sys.version_info))))
        with LOCK:
            answer: tuple[int, bytes, Any] = script(folder, guid).connect(name, guid, folder, logging == "1")
        return answer
    except KeyboardInterrupt:
        raise
    except BaseException as problem:  # whatever it is, it has to become a message
        text = " ".join(str(problem).split())
        text = text if isinstance(problem, ImportError) else f"{type(problem).__name__}: {text}"
        text = text.replace("%", "%%").replace("#", "##")
        return ERROR, f"{ERROR}logStatusError\0fmi2Instantiate: {text}\0".encode(), None


def find(where: str) -> pathlib.Path:
    """The folder of a URI or, as some programs have it, of a path."""
    if where.startswith("file:"):
        where = urllib.request.url2pathname(urllib.parse.urlsplit(where).path)
    return pathlib.Path(where)


def script(folder: pathlib.Path, guid: str) -> Any:
    """The module of an FMU under a name that no other FMU has; the search path stays as it is."""
    stem = (folder / "slavemodule.txt").read_text(encoding="utf-8").strip()
    name = f"{stem}_{guid.strip('{}').replace('-', '')}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, folder / f"{stem}.py")
        if spec is None or spec.loader is None:
            raise ImportError(f"{folder / stem}.py is no Python file")
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
