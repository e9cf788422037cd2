"""A machine without physics and a server around it; the command `harvester view`."""

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import uvicorn
from kit.wait import LONG, until

from fmus.machine.build import VIEW
from orchestrator.base.toml import read, read_dataclass
from orchestrator.drive.view_description import ViewDescription
from orchestrator.realtime.setup import Timing
from orchestrator.view.access import Guard, Rules, rules
from orchestrator.view.authority import ControlAuthority
from orchestrator.view.live import Pages
from orchestrator.view.server import application
from orchestrator.view.server_load import TimedConnection
from orchestrator.view.session import columns

# how the harvester is driven, as its own description says
DESCRIPTION = read_dataclass(ViewDescription, read(Path(VIEW), VIEW.read_bytes()))
MODES = DESCRIPTION.modes
TIMEOUT, SILENCE_LIMIT = 4 * LONG, 8 * LONG  # s, of a authority that must not lose them by itself
LEVERS = ("swing.swing_command", "boom_stick.boom_command", "boom_stick.stick_command")
URL = 1  # of the lines that `started` gives
DRIVEN = ("swing_lever", "boom_lever", "stick_lever", "engaged")
DRIVEN += ("radial_velocity", "vertical_velocity", "swing_velocity")
CONTROLLER = tuple(f"controller.{name}" for name in DRIVEN)


@dataclass
class StandIn:
    """Keeps its commands; with frames it can be watched too."""

    axes: tuple[str, ...] = LEVERS
    signals: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    commands: list[dict[str, float]] = field(default_factory=list)
    frames: list[tuple[float, list[float]]] = field(default_factory=list)
    still: dict[str, float] = field(default_factory=dict)
    state: str = "running"
    number: int = 0

    def command(self, values: Mapping[str, float]) -> None:
        self.commands.append(dict(values))

    def latest(self) -> Any:
        """A new frame; what drives it is at rest, but for what a test sets in `still`."""
        self.number += self.state == "running"
        values = np.array(self.frames[-1][1] if self.frames else [0.0] * len(self.signals))
        named = {"number": self.number, "state": self.state, "axes": self._axes(), "values": values}
        return SimpleNamespace(t=0.01 * self.number, message="", timing=Timing(), **named)

    def _axes(self) -> np.ndarray:
        return np.array([self.still.get(name, 0.0) for name in self.axes])

    @property
    def moving(self) -> bool:
        """Whether the last command was anything but rest."""
        return bool(self.commands) and any(self.commands[-1].values())

    def since(self, number: int) -> tuple[Any, ...]:
        first = max(number + 1, 0)
        part = self.frames[first:]
        values = np.array([row for _, row in part]).reshape(len(part), len(self.signals))
        numbers, times = np.arange(first, first + len(part)), np.array([t for t, _ in part])
        return numbers, times, np.tile(self._axes(), (len(part), 1)), values


def session(machine: StandIn, plan: Any) -> Any:
    """Of a machine without physics."""
    named = {"machine": machine, "columns": columns(machine), "plan": plan, "starts": 0, "factor": 1.0}
    return SimpleNamespace(**named, title="", folders=())


def pages(
    machine: StandIn,
    authority: ControlAuthority,
    description: ViewDescription = DESCRIPTION,
    parameters: Mapping[str, float] | None = None,
) -> Pages:
    """The pages of a machine; without parameters it has no scene."""
    plan = SimpleNamespace(description=description, parameters=parameters, findings=())
    return Pages(session(machine, plan), authority)


@dataclass
class Server:
    """A running server on a port of its own; `silence` moves the clock of its authority on."""

    machine: StandIn
    authority: ControlAuthority
    port: int
    http: str
    socket: str
    rules: Rules
    silence: Callable[[float], None]


@contextlib.contextmanager
def serving(
    host: str = "127.0.0.1",
    description: ViewDescription = DESCRIPTION,
    parameters: Mapping[str, float] | None = None,
    axes: tuple[str, ...] = LEVERS,
) -> Iterator[Server]:
    """The page, its websocket, and the guard around both.

    Its authority has so much timeout that a halt of this computer never uses it up, and no test waits for it:
    what rests does so for a reason. Silence comes by moving the authority's clock.
    """
    machine, passed = StandIn(axes), [0.0]
    limits = {"timeout": TIMEOUT, "silence_limit": SILENCE_LIMIT}
    limits["clock"] = lambda: time.monotonic() + sum(passed)
    authority, asked = ControlAuthority(machine, lambda: description, **limits), rules(host)
    app = application(pages(machine, authority, description, parameters))
    app.add_middleware(Guard, rules=asked)
    options = {"log_level": "error", "ws_max_size": 2**16, "ws": "websockets-sansio", "http": TimedConnection}
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, **options))
    thread = threading.Thread(target=server.run)
    thread.start()
    assert until(lambda: server.started)
    try:
        port = server.servers[0].sockets[0].getsockname()[1]
        addresses = f"http://127.0.0.1:{port}", f"ws://127.0.0.1:{port}/live"
        yield Server(machine, authority, port, *addresses, asked, passed.append)
    finally:
        server.should_exit = True
        thread.join(LONG)


@contextlib.contextmanager
def started(fmu_dir: Path, folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """`harvester view` in its own process, and what it says when it is ready; it ends in any case."""
    command = [sys.executable, "-m", "orchestrator", "view", str(fmu_dir / "harvester.ssp"), "--no-open"]
    command += ["--port", "0", "--results", str(folder), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield child, [child.stdout.readline().strip() for _ in range(3)]
        finally:
            child.kill()
