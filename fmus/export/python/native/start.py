"""The Python code inside the library of a Python FMU: it finds and loads the script of the FMU."""

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
# This code runs for every instance, in one module: setdefault keeps the lock of the first instance. Without
# the lock a thread could get a script that another thread has loaded only in part.
LOCK = globals().setdefault("LOCK", threading.RLock())


def start(*arguments: bytes) -> tuple[int, bytes, Any]:
    """Status, messages and dispatcher of a new instance; raises nothing except KeyboardInterrupt."""
    try:
        name, guid, location, logging = (value.decode() for value in arguments)
        folder = find(location)
        environment = os.environ.get("VIRTUAL_ENV")  # of a program started from an activated environment
        if environment and importlib.util.find_spec("fmus") is None:
            for packages in ("lib/python{0}.{1}/site-packages", "Lib/site-packages"):
                site.addsitedir(str(pathlib.Path(environment, packages.format(*sys.version_info))))
        with LOCK:
            result: tuple[int, bytes, Any] = script(folder, guid).connect(name, guid, folder, logging == "1")
        return result
    except KeyboardInterrupt:
        raise
    except BaseException as problem:  # any exception must become a message
        text = " ".join(str(problem).split())
        text = text if isinstance(problem, ImportError) else f"{type(problem).__name__}: {text}"
        text = text.replace("%", "%%").replace("#", "##")
        return ERROR, f"{ERROR}logStatusError\0fmi2Instantiate: {text}\0".encode(), None


def find(location: str) -> pathlib.Path:
    """The folder of a URI; some importers pass a path instead."""
    if location.startswith("file:"):
        location = urllib.request.url2pathname(urllib.parse.urlsplit(location).path)
    return pathlib.Path(location)


def script(folder: pathlib.Path, guid: str) -> Any:
    """The module of an FMU under a unique name; the search path does not change."""
    stem = (folder / "slavemodule.txt").read_text(encoding="utf-8").strip()
    name = f"{stem}_{guid.strip('{}').replace('-', '')}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, folder / f"{stem}.py")
        if spec is None or spec.loader is None:
            raise ImportError(f"{folder / stem}.py is not a Python file")
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
