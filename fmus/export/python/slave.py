"""The slave in an FMU whose code is Python, and the FMI functions as the FMU's library calls them.

The script of an FMU defines one class from `SubsystemSlave` or `UserSlave`; what their methods do is in
`instance`. Our own library (native/python_fmu.c) calls it through a `Dispatcher`: names and bytes in, bytes
out. PythonFMU's library can call it, too, within what that one offers.

No exception leaves the dispatcher but an interrupt by the user, which the library hands on to the program. An
answer is a status, messages and a value. Statuses and log categories are those of the native FMUs.
"""

from __future__ import annotations

import json
import sys
from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmus.export.interface import interface_of
from fmus.export.model_description import LOG_CATEGORIES
from fmus.export.python.instance import ANY, INSTANTIATED, STEP_FAILED, Instance
from fmus.export.python.subsystem_model import (
    RunnableModel,
    SubsystemFunctions,
    SubsystemModel,
    fingerprint,
    subsystem,
)
from fmus.export.python.user_file import load, message
from fmus.export.python.user_model import UserModel
from fmus.parameters import Values
from orchestrator.base.errors import Problem
from orchestrator.ssp.xml_writing import package_version

MODEL_FILE = "model.json"  # in resources/: what the FMU was built from


class PythonSlave(Fmi2Slave):  # type: ignore[misc]
    """One instance; methods raise, but `do_step` logs what went wrong and returns False."""

    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.folder = Path(self.resources)
        self.built = json.loads((self.folder / MODEL_FILE).read_text(encoding="utf-8"))
        self.guid = self.built["guid"]
        self._check_version()
        self.instance = Instance(self.model(), self.guid, self._warn)

    @abstractmethod
    def model(self) -> RunnableModel:
        """The model."""

    def _check_version(self) -> None:
        name, built, here = self.built["name"], self.built["version"], package_version()
        if built != here:
            raise Problem(
                f"{name}: built with harvester-cosim {built}, the one in {sys.prefix} is {here}: "
                f"install {built}, or build the FMU again"
            )

    def _warn(self, text: str) -> None:
        self.log(text, Fmi2Status.warning)

    # ---- PythonFMU's names

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """See `Instance.setup`."""
        self.instance.setup(start_time, stop_time, tolerance)

    def enter_initialization_mode(self) -> None:
        """See `Instance.enter`."""
        self.instance.enter()

    def exit_initialization_mode(self) -> None:
        """See `Instance.exit`."""
        self.instance.exit()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """See `Instance.step`; false after a message when it failed."""
        try:
            self.instance.step(current_time, step_size)
        except Exception as problem:
            self.log(message(problem, self.folder), Fmi2Status.error)
            return False
        return True

    def terminate(self) -> None:
        """See `Instance.terminate`."""
        self.instance.terminate()

    def get_real(self, vrs: list[int]) -> list[float]:
        """See `Instance.get`."""
        return self.instance.get(vrs)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """See `Instance.set`."""
        self.instance.set(vrs, values)

    def _get_fmu_state(self) -> dict[str, str]:
        return {"state": self.instance.save().hex()}

    def _set_fmu_state(self, state: dict[str, str]) -> None:
        self.instance.restore(bytes.fromhex(state["state"]))


_SHARED: dict[
    str, SubsystemFunctions
] = {}  # by the text of model.json: all instances of an FMU share the functions


class SubsystemSlave(PythonSlave):
    """A slave of a `Subsystem` of an installed package."""

    def model(self) -> RunnableModel:
        """The subsystem that the FMU was built from, with the numbers it was built with."""
        return SubsystemModel(self._functions)

    @cached_property
    def _functions(self) -> SubsystemFunctions:
        key = json.dumps(self.built)
        if key not in _SHARED:
            sub = subsystem(self.built["origin"])
            interface = interface_of(sub, Values(**self.built["numbers"]))
            if fingerprint(interface) != self.built["fingerprint"]:
                raise Problem(
                    f"{self.built['name']}: {self.built['origin']} in {sys.prefix} has other equations or "
                    "variables than the FMU was built from: build the FMU again"
                )
            _SHARED[key] = SubsystemFunctions(interface)
        return _SHARED[key]


class UserSlave(PythonSlave):
    """A slave of a model that a user wrote, in a file beside the script."""

    def model(self) -> RunnableModel:
        """The model in the user's file."""
        return UserModel(load(self.folder / self.built["file"]))


# ---- calls of the library ---------------------------------------------------------------------------

OK, WARNING, DISCARD, ERROR = range(4)
CATEGORIES = dict(zip((OK, WARNING, DISCARD, ERROR), LOG_CATEGORIES, strict=False))  # logAll is all of them
ALWAYS = {WARNING, ERROR}  # logged without debug logging, too


class NotAvailable(Problem):
    """What was asked for is not there; nothing else is wrong."""


class Failed(Exception):
    """The message is in the log already."""


def connect(
    model: Callable[..., PythonSlave], name: str, guid: str, folder: Path, logging: bool
) -> tuple[int, bytes, Dispatcher | None]:
    """What answers the calls of a new instance, or why there is none."""
    try:
        if not name.strip():
            raise Problem("the instance name is empty")
        slave = model(instance_name=name, resources=str(folder), logger=0, visible=0)
        if guid != slave.guid:
            raise Problem(f'the GUID differs, expected "{slave.guid}" (files of different builds)')
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        return ERROR, _record(ERROR, "fmi2Instantiate", message(problem, folder)), None
    return OK, b"", Dispatcher(slave, set(CATEGORIES) if logging else set(ALWAYS))


def _record(kind: int, function: str, text: str) -> bytes:
    """A message as native/python_fmu.c reads it; "%" and "#" mean something to loggers."""
    line = f"{function}: {text}".replace("%", "%%").replace("#", "##").replace("\0", " ")
    return f"{kind}{CATEGORIES[kind]}\0{line}\0".encode("utf-8", "replace")


class Dispatcher:
    """One instance as the library sees it; `logged` are the kinds of messages that go out."""

    def __init__(self, slave: PythonSlave, logged: set[int]) -> None:
        self.slave, self.instance, self.logged = slave, slave.instance, logged

    def __call__(self, name: bytes, *given: bytes) -> tuple[int, bytes, bytes]:
        """The answer to an FMI function."""
        function, status, value = name.decode(), OK, b""
        events = [(OK, f"t = {self.instance.state.time:.9g} s")]
        problems: list[tuple[int, str]] = []
        try:
            value = CALLS[function](self, *given) or b""
        except Failed:
            status = ERROR
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # one that went on into the library would end the program
            status = DISCARD if isinstance(problem, NotAvailable) else ERROR
            problems = [(status, message(problem, self.slave.folder))]
        messages = [*events, *self._queued(), *problems]
        return status, b"".join(_record(k, function, text) for k, text in messages if k in self.logged), value

    def _queued(self) -> list[tuple[int, str]]:
        taken = [(int(m.status), m.msg) for m in self.slave.log_queue]
        self.slave.log_queue.clear()
        return taken


# ---- FMI functions: bytes are arrays of C


def _doubles(data: bytes) -> list[float]:
    return np.frombuffer(data, dtype=np.float64).tolist()  # type: ignore[no-any-return]


def _integers(data: bytes) -> list[int]:
    return np.frombuffer(data, dtype=np.int32).tolist()  # type: ignore[no-any-return]


def _references(data: bytes) -> list[int]:
    return np.frombuffer(data, dtype=np.uint32).tolist()  # type: ignore[no-any-return]


def _packed(values: list[float]) -> bytes:
    return np.array(values, dtype=np.float64).tobytes()


def _setup(calls: Dispatcher, numbers: bytes) -> None:
    has_tolerance, tolerance, start, has_stop, stop = _doubles(numbers)
    calls.slave.setup_experiment(start, stop if has_stop else None, tolerance if has_tolerance else None)


def _step(calls: Dispatcher, numbers: bytes) -> None:
    if not calls.slave.do_step(*_doubles(numbers)):
        raise Failed


def _log(calls: Dispatcher, on: bytes, names: bytes) -> None:
    wanted, switch = set[int](), _integers(on)[0]
    kinds = {category: {kind} for kind, category in CATEGORIES.items()} | {"logAll": set(CATEGORIES)}
    for name in names.decode().splitlines():
        if name not in kinds:
            raise Problem(f'log category "{name}" is unknown')
        wanted |= kinds[name]
    if not names:  # everything is meant; warnings and errors can be silenced only by name
        wanted = set(CATEGORIES) if switch else set(CATEGORIES) - ALWAYS
    calls.logged = calls.logged | wanted if switch else calls.logged - wanted


def _readable(calls: Dispatcher, data: bytes) -> None:
    calls.instance.readable(data)


def _none(_: Dispatcher, references: bytes) -> None:
    if references:
        raise Problem("the model has Real variables only")


def _cancel(_: Dispatcher) -> None:
    raise Problem("no step is in progress: fmi2DoStep returns when it is done")


def _status(kind: int, answer: Callable[[Dispatcher], bytes]) -> Callable[[Dispatcher, bytes], bytes]:
    """A function for the status of this kind; there is no other."""

    def give(calls: Dispatcher, asked: bytes) -> bytes:
        calls.instance.allowed(ANY & ~INSTANTIATED)
        if _integers(asked)[0] != kind:
            raise NotAvailable("there is no such status")
        return answer(calls)

    return give


def _failed(calls: Dispatcher) -> bytes:
    failed = int(calls.instance.state.phase) == STEP_FAILED
    return np.array([ERROR if failed else OK], dtype=np.int32).tobytes()


CALLS: Mapping[str, Callable[..., bytes | None]] = {
    "fmi2SetupExperiment": _setup,
    "fmi2EnterInitializationMode": lambda calls: calls.slave.enter_initialization_mode(),
    "fmi2ExitInitializationMode": lambda calls: calls.slave.exit_initialization_mode(),
    "fmi2Terminate": lambda calls: calls.slave.terminate(),
    "fmi2Reset": lambda calls: calls.instance.reset(),
    "fmi2SetDebugLogging": _log,
    "fmi2DoStep": _step,
    "fmi2CancelStep": _cancel,
    "fmi2GetReal": lambda calls, vr: _packed(calls.slave.get_real(_references(vr))),
    "fmi2SetReal": lambda calls, vr, v: calls.slave.set_real(_references(vr), _doubles(v)),
    **{f"fmi2{verb}{kind}": _none for verb in ("Get", "Set") for kind in ("Integer", "Boolean", "String")},
    "fmi2SetRealInputDerivatives": lambda calls, vr, orders, v: calls.instance.set_input_derivatives(
        _references(vr), _integers(orders), _doubles(v)
    ),
    "fmi2GetRealOutputDerivatives": lambda calls, vr, orders: _packed(
        calls.instance.output_derivatives(_references(vr), _integers(orders))
    ),
    "fmi2GetDirectionalDerivative": lambda calls, unknown, known, seed: _packed(
        calls.instance.directional_derivative(_references(unknown), _references(known), _doubles(seed))
    ),
    "fmi2GetFMUstate": lambda calls: calls.instance.save(),
    "fmi2SetFMUstate": lambda calls, data: calls.instance.restore(data),
    "fmi2DeSerializeFMUstate": _readable,
    "fmi2GetStatus": _status(0, _failed),
    "fmi2GetRealStatus": _status(2, lambda calls: _packed([calls.instance.state.time])),
    "fmi2GetBooleanStatus": _status(3, lambda _: np.zeros(1, dtype=np.int32).tobytes()),
    "fmi2GetIntegerStatus": _status(-1, lambda _: b""),
    "fmi2GetStringStatus": _status(1, lambda _: b""),
}
