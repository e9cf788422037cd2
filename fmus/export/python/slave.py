"""The slave class of FMUs in Python, and the dispatcher through which the FMU's library calls it.

The script of an FMU defines a subclass of `PythonSlave`, whose methods call an `Instance`.
The library (native/python_fmu.c) calls a `Dispatcher` with the name of an FMI function and its arguments as
bytes; the result is a status, messages and a value as bytes. The library of PythonFMU can call the slave as
well, with the functions that it supports.

The dispatcher raises no exception except KeyboardInterrupt, which the library passes on to the program.
Statuses and log categories are those of FMUs with C code.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmus.export.model_description import LOG_CATEGORIES
from fmus.export.python.instance import ANY, INSTANTIATED, STEP_FAILED, Instance
from fmus.export.python.user_model import UserModel, load, message
from orchestrator.base.errors import Problem
from orchestrator.base.xml import package_version

MODEL_FILE = "model.json"  # in resources/: name and file of the model, version, GUID


class PythonSlave(Fmi2Slave):  # type: ignore[misc]
    """One instance. Methods raise an exception if they fail; `do_step` logs the message and returns False."""

    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, *, instance_name: str, resources: str, logger: int = 0, visible: int = 0) -> None:
        """The arguments with which the library of PythonFMU calls it."""
        super().__init__(instance_name=instance_name, resources=resources, logger=logger, visible=visible)
        self.folder = Path(self.resources)
        self.built = json.loads((self.folder / MODEL_FILE).read_text(encoding="utf-8"))
        self.guid = self.built["guid"]
        self._check_version()
        model = UserModel(load(self.folder / self.built["file"]))
        self.instance = i = Instance(model, self.guid, lambda text: self.log(text, Fmi2Status.warning))
        # what the library of PythonFMU calls; it also calls do_step and saves and restores states
        self.setup_experiment, self.terminate = i.setup, i.terminate
        self.enter_initialization_mode, self.exit_initialization_mode = i.enter, i.exit
        self.get_real, self.set_real = i.get, i.set

    def _check_version(self) -> None:
        name, built, installed = self.built["name"], self.built["version"], package_version()
        if built != installed:
            raise Problem(
                f"{name}: built with harvester-cosim {built}, the one in {sys.prefix} is {installed}: "
                f"install {built}, or build the FMU again"
            )

    def do_step(self, current_time: float, step_size: float) -> bool:
        """See `Instance.step`; logs a message and returns False if it failed."""
        try:
            self.instance.step(current_time, step_size)
        except Exception as problem:
            self.log(message(problem, self.folder), Fmi2Status.error)
            return False
        return True

    def _get_fmu_state(self) -> dict[str, str]:
        return {"state": self.instance.save().hex()}

    def _set_fmu_state(self, state: dict[str, str]) -> None:
        self.instance.restore(bytes.fromhex(state["state"]))


# ---- dispatcher ---------------------------------------------------------------------------

OK, WARNING, DISCARD, ERROR = range(4)
CATEGORIES = dict(zip((OK, WARNING, DISCARD, ERROR), LOG_CATEGORIES, strict=False))  # without logAll
ALWAYS_LOGGED = {WARNING, ERROR}  # even if debug logging is off


class NotAvailable(Problem):
    """The requested value does not exist; the status is fmi2Discard."""


class Failed(Exception):
    """A call that failed and has logged its message."""


def connect(
    model: Callable[..., PythonSlave], name: str, guid: str, folder: Path, logging: bool
) -> tuple[int, bytes, Dispatcher | None]:
    """Status, messages and dispatcher of a new instance; None if it cannot be created."""
    try:
        if not name.strip():
            raise Problem("the instance name is empty")
        slave = model(instance_name=name, resources=str(folder))
        if guid != slave.guid:
            raise Problem(f'the GUID differs, expected "{slave.guid}" (files of different builds)')
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        return ERROR, _record(ERROR, "fmi2Instantiate", message(problem, folder)), None
    return OK, b"", Dispatcher(slave, set(CATEGORIES) if logging else set(ALWAYS_LOGGED))


def _record(status: int, function: str, text: str) -> bytes:
    """A message as native/python_fmu.c reads it; "%" and "#" are doubled because loggers interpret them."""
    line = f"{function}: {text}".replace("%", "%%").replace("#", "##").replace("\0", " ")
    return f"{status}{CATEGORIES[status]}\0{line}\0".encode("utf-8", "replace")


class Dispatcher:
    """Calls the slave for the library; logged: the statuses whose messages are returned."""

    def __init__(self, slave: PythonSlave, logged: set[int]) -> None:
        self.slave, self.instance, self.logged = slave, slave.instance, logged

    def __call__(self, name: bytes, *arguments: bytes) -> tuple[int, bytes, bytes]:
        """Status, messages and value of an FMI function; arrays of C as bytes."""
        function, status, value = name.decode(), OK, b""
        events = [(OK, f"t = {self.instance.state.time:.9g} s")]
        problems: list[tuple[int, str]] = []
        try:
            value = CALLS[function](self, *arguments) or b""
        except Failed:
            status = ERROR
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # the library could not handle it
            status = DISCARD if isinstance(problem, NotAvailable) else ERROR
            problems = [(status, message(problem, self.slave.folder))]
        queued = [(int(m.status), m.msg) for m in self.slave.log_queue]
        self.slave.log_queue.clear()
        messages = [*events, *queued, *problems]
        return status, b"".join(_record(s, function, text) for s, text in messages if s in self.logged), value


# ---- FMI functions


def _values(dtype: type[np.generic], data: bytes) -> Any:
    """The numbers in an array of C, as a list."""
    return np.frombuffer(data, dtype).tolist()


_doubles, _integers, _references = (partial(_values, t) for t in (np.float64, np.int32, np.uint32))


def _packed(values: list[float]) -> bytes:
    return np.array(values, dtype=np.float64).tobytes()


def _setup(calls: Dispatcher, values: bytes) -> None:
    has_tolerance, tolerance, start, has_stop, stop = _doubles(values)
    calls.instance.setup(start, stop if has_stop else None, tolerance if has_tolerance else None)


def _step(calls: Dispatcher, values: bytes) -> None:
    if not calls.slave.do_step(*_doubles(values)):
        raise Failed


def _log(calls: Dispatcher, on: bytes, names: bytes) -> None:
    selected, logging_on = set[int](), _integers(on)[0]
    statuses = {category: {status} for status, category in CATEGORIES.items()} | {"logAll": set(CATEGORIES)}
    for name in names.decode().splitlines():
        if name not in statuses:
            raise Problem(f'log category "{name}" is unknown')
        selected |= statuses[name]
    if not names:  # all categories are meant; warnings and errors can be switched off only by name
        selected = set(CATEGORIES) if logging_on else set(CATEGORIES) - ALWAYS_LOGGED
    calls.logged = calls.logged | selected if logging_on else calls.logged - selected


def _check_state(calls: Dispatcher, data: bytes) -> None:
    calls.instance.read_state(data)


def _no_variables(_: Dispatcher, references: bytes) -> None:
    if references:
        raise Problem("the model has Real variables only")


def _no_derivatives(*_: object) -> None:
    raise Problem("a model written by hand has no derivatives of outputs")


def _cancel(_: Dispatcher) -> None:
    raise Problem("no step is in progress: fmi2DoStep returns when it is done")


def _status(kind: int, value: Callable[[Dispatcher], bytes]) -> Callable[[Dispatcher, bytes], bytes]:
    """An FMI function that returns the status of this fmi2StatusKind and refuses all others."""

    def get_status(calls: Dispatcher, requested: bytes) -> bytes:
        calls.instance.require_phase(ANY & ~INSTANTIATED)
        if _integers(requested)[0] != kind:
            raise NotAvailable("there is no such status")
        return value(calls)

    return get_status


def _step_status(calls: Dispatcher) -> bytes:
    failed = int(calls.instance.state.phase) == STEP_FAILED
    return np.array([ERROR if failed else OK], dtype=np.int32).tobytes()


CALLS: Mapping[str, Callable[..., bytes | None]] = {
    "fmi2SetupExperiment": _setup,
    "fmi2EnterInitializationMode": lambda calls: calls.instance.enter(),
    "fmi2ExitInitializationMode": lambda calls: calls.instance.exit(),
    "fmi2Terminate": lambda calls: calls.instance.terminate(),
    "fmi2Reset": lambda calls: calls.instance.reset(),
    "fmi2SetDebugLogging": _log,
    "fmi2DoStep": _step,
    "fmi2CancelStep": _cancel,
    "fmi2GetReal": lambda calls, vr: _packed(calls.instance.get(_references(vr))),
    "fmi2SetReal": lambda calls, vr, v: calls.instance.set(_references(vr), _doubles(v)),
    **{
        f"fmi2{verb}{type_}": _no_variables
        for verb in ("Get", "Set")
        for type_ in ("Integer", "Boolean", "String")
    },
    "fmi2SetRealInputDerivatives": lambda calls, vr, orders, v: calls.instance.set_input_derivatives(
        _references(vr), _integers(orders), _doubles(v)
    ),
    "fmi2GetRealOutputDerivatives": _no_derivatives,
    "fmi2GetDirectionalDerivative": _no_derivatives,
    "fmi2GetFMUstate": lambda calls: calls.instance.save(),
    "fmi2SetFMUstate": lambda calls, data: calls.instance.restore(data),
    "fmi2DeSerializeFMUstate": _check_state,
    "fmi2GetStatus": _status(0, _step_status),
    "fmi2GetRealStatus": _status(2, lambda calls: _packed([calls.instance.state.time])),
    "fmi2GetBooleanStatus": _status(3, lambda _: np.zeros(1, dtype=np.int32).tobytes()),
    "fmi2GetIntegerStatus": _status(-1, lambda _: b""),
    "fmi2GetStringStatus": _status(1, lambda _: b""),
}
