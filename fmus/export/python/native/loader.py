"""The Python code inside the library of a Python FMU: it finds the package and loads the model of the FMU."""

import importlib.util
import json
import os
import pathlib
import site
import sys
import threading
import urllib.parse
import urllib.request
from typing import Any

# This code runs for every library, in one module: setdefault keeps the lock of the first one. Without the
# lock a thread could get a model whose file another thread has loaded only in part.
LOCK = globals().setdefault("LOCK", threading.RLock())


def load(location: str, guid: str) -> Any:
    """The model of an FMU, or the reason as text; raises nothing except KeyboardInterrupt."""
    try:
        folder = find(location)
        built = json.loads((folder / "model.json").read_text(encoding="utf-8"))
        environment = os.environ.get("VIRTUAL_ENV")  # of a program started from an activated environment
        if environment and importlib.util.find_spec("fmus") is None:
            for packages in ("lib/python{0}.{1}/site-packages", "Lib/site-packages"):
                site.addsitedir(str(pathlib.Path(environment, packages.format(*sys.version_info))))
        needed = f"{built['name']} needs the package harvester-cosim {built['version']}"
        with LOCK:
            try:
                from fmus.export.python.slave import connect
            except ImportError as problem:
                return text_of(f"{needed} in the Python in {sys.prefix}: {problem}")
            return connect(folder, built, guid)
    except KeyboardInterrupt:
        raise
    except BaseException as problem:  # any exception must become a message
        return text_of(f"{type(problem).__name__}: {problem}")


def text_of(message: str) -> str:
    """A message in one line that can be encoded."""
    return " ".join(message.split()).encode("utf-8", "replace").decode()


def find(location: str) -> pathlib.Path:
    """The folder of a URI; some importers pass a path instead."""
    if location.startswith("file:"):
        location = urllib.request.url2pathname(urllib.parse.urlsplit(location).path)
    return pathlib.Path(location)
