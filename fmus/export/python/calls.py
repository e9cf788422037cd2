"""Answers the calls of the FMU's library (native/python_fmu.c): names and bytes in, bytes out. No exception
leaves but an interrupt by the user, which the library hands on to the program.

An answer is a status, messages and a value. Statuses and log categories are those of the native FMUs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from fmus.export.model_description import LOG_CATEGORIES
from fmus.export.python import derivatives
from fmus.export.python.instance import ANY, INSTANTIATED, STEP_FAILED, told
from fmus.export.python.slave import Slave
from orchestrator.base.errors import Problem

OK, WARNING, DISCARD, ERROR = range(4)
CATEGORIES = dict(zip((OK, WARNING, DISCARD, ERROR), LOG_CATEGORIES, strict=False))  # logAll is all of them
ALWAYS = {WARNING, ERROR}  # logged without debug logging, too


class Discarded(Problem):
    """What was asked for is not there; nothing else is wrong."""


class Failed(Exception):
    """The message is in the log already."""


def connect(
    model: Callable[..., Slave], name: str, guid: str, folder: Path, logging: bool
) -> tuple[int, bytes, Door | None]:
    """The door to a new instance, or why there is none."""
    try:
        if not name.strip():
            raise Problem("the instance name is empty")
        slave = model(instance_name=name, resources=str(folder), logger=0, visible=0)
        if guid != slave.guid:
            raise Problem(f'the GUID differs, expected "{slave.guid}" (files of different builds)')
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        return ERROR, _record(ERROR, "fmi2Instantiate", told(problem, folder)), None
    return OK, b"", Door(slave, set(CATEGORIES) if logging else set(ALWAYS))


def _record(kind: int, function: str, text: str) -> bytes:
    """A message as native/python_fmu.c reads it; "%" and "#" mean something to loggers."""
    line = f"{function}: {text}".replace("%", "%%").replace("#", "##").replace("\0", " ")
    return f"{kind}{CATEGORIES[kind]}\0{line}\0".encode("utf-8", "replace")


class Door:
    """One instance as the library sees it; `logged` are the kinds of messages that go out."""

    def __init__(self, slave: Slave, logged: set[int]) -> None:
        self.slave, self.logged = slave, logged

    def __call__(self, name: bytes, *given: bytes) -> tuple[int, bytes, bytes]:
        """The answer to an FMI function."""
        function, status, value = name.decode(), OK, b""
        events = [(OK, f"t = {self.slave.instance.state.time:.9g} s")]
        problems: list[tuple[int, str]] = []
        try:
            value = CALLS[function](self, *given) or b""
        except Failed:
            status = ERROR
        except KeyboardInterrupt:
            raise
        except BaseException as problem:  # one that went on into the library would end the program
            status = DISCARD if isinstance(problem, Discarded) else ERROR
            problems = [(status, told(problem, self.slave.folder))]
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


def _setup(door: Door, numbers: bytes) -> None:
    has_tolerance, tolerance, start, has_stop, stop = _doubles(numbers)
    door.slave.setup_experiment(start, stop if has_stop else None, tolerance if has_tolerance else None)


def _step(door: Door, numbers: bytes) -> None:
    if not door.slave.do_step(*_doubles(numbers)):
        raise Failed


def _log(door: Door, on: bytes, names: bytes) -> None:
    wanted, switch = set[int](), _integers(on)[0]
    kinds = {category: {kind} for kind, category in CATEGORIES.items()} | {"logAll": set(CATEGORIES)}
    for name in names.decode().splitlines():
        if name not in kinds:
            raise Problem(f'log category "{name}" is unknown')
        wanted |= kinds[name]
    if not names:  # everything is meant; warnings and errors can be silenced only by name
        wanted = set(CATEGORIES) if switch else set(CATEGORIES) - ALWAYS
    door.logged = door.logged | wanted if switch else door.logged - wanted


def _readable(door: Door, data: bytes) -> None:
    door.slave.instance.readable(data)


def _none(_: Door, references: bytes) -> None:
    if references:
        raise Problem("the model has Real variables only")


def _cancel(_: Door) -> None:
    raise Problem("no step is in progress: fmi2DoStep returns when it is done")


def _status(kind: int, answer: Callable[[Door], bytes]) -> Callable[[Door, bytes], bytes]:
    """A function for the status of this kind; there is no other."""

    def give(door: Door, asked: bytes) -> bytes:
        door.slave.instance.allowed(ANY & ~INSTANTIATED)
        if _integers(asked)[0] != kind:
            raise Discarded("there is no such status")
        return answer(door)

    return give


def _failed(door: Door) -> bytes:
    failed = int(door.slave.instance.state.phase) == STEP_FAILED
    return np.array([ERROR if failed else OK], dtype=np.int32).tobytes()


CALLS: Mapping[str, Callable[..., bytes | None]] = {
    "fmi2SetupExperiment": _setup,
    "fmi2EnterInitializationMode": lambda door: door.slave.enter_initialization_mode(),
    "fmi2ExitInitializationMode": lambda door: door.slave.exit_initialization_mode(),
    "fmi2Terminate": lambda door: door.slave.terminate(),
    "fmi2Reset": lambda door: door.slave.instance.reset(),
    "fmi2SetDebugLogging": _log,
    "fmi2DoStep": _step,
    "fmi2CancelStep": _cancel,
    "fmi2GetReal": lambda door, vr: _packed(door.slave.get_real(_references(vr))),
    "fmi2SetReal": lambda door, vr, v: door.slave.set_real(_references(vr), _doubles(v)),
    **{f"fmi2{verb}{kind}": _none for verb in ("Get", "Set") for kind in ("Integer", "Boolean", "String")},
    "fmi2SetRealInputDerivatives": lambda door, vr, orders, v: derivatives.give(
        door.slave.instance, _references(vr), _integers(orders), _doubles(v)
    ),
    "fmi2GetRealOutputDerivatives": lambda door, vr, orders: _packed(
        derivatives.of_outputs(door.slave.instance, _references(vr), _integers(orders))
    ),
    "fmi2GetDirectionalDerivative": lambda door, unknown, known, seed: _packed(
        derivatives.directional(door.slave.instance, _references(unknown), _references(known), _doubles(seed))
    ),
    "fmi2GetFMUstate": lambda door: door.slave.instance.save(),
    "fmi2SetFMUstate": lambda door, data: door.slave.instance.restore(data),
    "fmi2DeSerializeFMUstate": _readable,
    "fmi2GetStatus": _status(0, _failed),
    "fmi2GetRealStatus": _status(2, lambda door: _packed([door.slave.instance.state.time])),
    "fmi2GetBooleanStatus": _status(3, lambda _: np.zeros(1, dtype=np.int32).tobytes()),
    "fmi2GetIntegerStatus": _status(-1, lambda _: b""),
    "fmi2GetStringStatus": _status(1, lambda _: b""),
}
