"""The first lines that run in Python, held by the library itself: they find the FMU's own script."""

import importlib.util
import os
import pathlib
import site
import sys
import urllib.parse
import urllib.request

ERROR = 3


def start(*given):
    """Status, messages and what answers the calls of a new instance; never raises."""
    try:
        name, guid, where, logging = (value.decode() for value in given)
        folder = _folder(where)
        own = os.environ.get("VIRTUAL_ENV")  # a tool that was started from an activated environment
        if own and importlib.util.find_spec("fmus") is None:
            for packages in pathlib.Path(own).glob("[Ll]ib/**/site-packages"):
                site.addsitedir(str(packages))
        return _script(folder, guid).connect(name, guid, folder, logging == "1")
    except BaseException as problem:  # whatever it is, it has to become a message
        text = " ".join(f"{problem}".split()) or type(problem).__name__
        text = text if isinstance(problem, ImportError) else f"{type(problem).__name__}: {text}"
        text = text.replace("%", "%%").replace("#", "##")
        return ERROR, f"{ERROR}logStatusError\0fmi2Instantiate: {text}\0".encode(), None


def _folder(where):
    """The folder of a URI or, as some tools have it, of a path."""
    if "://" in where or where.startswith("file:"):
        where = urllib.request.url2pathname(urllib.parse.urlsplit(where).path)
    return pathlib.Path(where)


def _script(folder, guid):
    """The module of an FMU under a name that no other FMU has; the search path stays as it is."""
    stem = (folder / "slavemodule.txt").read_text(encoding="utf-8").strip()
    name = f"{stem}_{guid.strip('{}').replace('-', '')}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, folder / f"{stem}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
