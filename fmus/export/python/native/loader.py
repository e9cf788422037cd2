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

# This code runs for every library, in one module: setdefault keeps the lock of the first one. Without the
# lock a thread could get a script that another thread has loaded only in part.
LOCK = globals().setdefault("LOCK", threading.RLock())


def load(location: str, guid: str) -> Any:
    """The model of an FMU, or the reason as text; raises nothing except KeyboardInterrupt."""
    try:
        folder = find(location)
        environment = os.environ.get("VIRTUAL_ENV")  # of a program started from an activated environment
        if environment and importlib.util.find_spec("fmus") is None:
            for packages in ("lib/python{0}.{1}/site-packages", "Lib/site-packages"):
                site.addsitedir(str(pathlib.Path(environment, packages.format(*sys.version_info))))
        with LOCK:
            return script(folder, guid).connect(folder, guid)
    except KeyboardInterrupt:
        raise
    except BaseException as problem:  # any exception must become a message
        text = " ".join(str(problem).split()).encode("utf-8", "replace").decode()
        return text if isinstance(problem, ImportError) else f"{type(problem).__name__}: {text}"


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
