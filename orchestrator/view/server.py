"""The web server of the view: one session and any number of pages, behind access control."""

import asyncio
import contextlib
import gc
import logging
import socket
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import replace
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Response
from nicegui import Client, core, ui
from nicegui import app as nicegui

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder, require_system
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.replay import Replay
from orchestrator.realtime.setup import failures_reported
from orchestrator.view import access
from orchestrator.view.access import Guard, rules
from orchestrator.view.choice import MachineChoice
from orchestrator.view.driving.authority import ControlAuthority
from orchestrator.view.driving.endpoint import serve as serve_controls
from orchestrator.view.driving.endpoint import watching
from orchestrator.view.page import Page, SharedFigures, Stream
from orchestrator.view.server_load import REQUESTS, PageInterval, TimedConnection
from orchestrator.view.session import Session
from orchestrator.view.task.training import Training

TITLE = "Harvester"
LOOPBACK = "127.0.0.1"
SHORTEST = 16  # characters of a chosen token, at least
LARGEST = 2**16  # bytes of one message of a browser; ordinary messages are far smaller
GRACE = 2  # s for open connections at the end
TIMEOUT = 20.0  # s for a page that is slow to load or has lost its connection


class Server:
    """Serves a session. One per process, because NiceGUI has one application per process.

    url         address of the page, with the token if one is required
    authority   decides which page drives the machine
    """

    def __init__(self, session: Session, host: str = LOOPBACK, port: int = 0, token: str = "") -> None:
        """port: 0 selects a free one; token: by default random, if `host` is not a loopback address."""
        if token and len(token) < SHORTEST:
            raise Problem(f"--token: expected at least {SHORTEST} characters, got {len(token)}")
        self.session, self._training = session, Training(session.machine)
        self.authority = ControlAuthority(
            session.machine, lambda: session.plan.description.modes, loads=self._training.loads
        )
        self._socket = bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        default = rules(host, names=(_displayed(host),), port=self.port)
        allowed = replace(default, token=token or default.token)
        query = f"?token={allowed.token}" if allowed.token else ""
        self.url = f"http://{_displayed(host)}:{self.port}/{query}"
        app = FastAPI(lifespan=self._life, docs_url=None, redoc_url=None, openapi_url=None)
        serve_controls(app, self.authority)
        self._stream = Stream(session, SharedFigures(session))
        ui.page("/")(self._page)
        ui.run_with(app, title=TITLE, tailwind=False, show_welcome_message=False, reconnect_timeout=TIMEOUT)
        # NiceGUI would build a page for an unknown path, and serve long polls next to its websocket
        nicegui.add_exception_handler(404, _not_found)
        # no loading bar, because a screen reader finds no name on it
        nicegui.config.quasar_config["loadingBar"]["skipHijack"] = True
        nicegui.config.socket_io_js_transports = core.sio.eio.transports = ["websocket"]
        app.add_middleware(PageInterval)
        app.add_middleware(Guard, rules=allowed)
        config = uvicorn.Config(
            app,
            log_level="warning",
            ws="websockets-sansio",
            ws_max_size=LARGEST,
            ws_per_message_deflate=False,  # compressing many small messages costs more than it saves
            timeout_graceful_shutdown=GRACE,
            http=TimedConnection,
            limit_concurrency=REQUESTS,
        )
        self._server = uvicorn.Server(config)
        self._thread: threading.Thread | None = None

    def run(self, began: Callable[[], object] = lambda: None) -> None:
        """Serve until interrupted. began: called when the server accepts connections."""
        self._began = began
        self._server.run(sockets=[self._socket])

    def start(self) -> None:
        """Serve in a thread. Returns when the server accepts connections."""
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()
        while not self._server.started:
            if not self._thread.is_alive():
                raise Problem("the server did not start")
            self._thread.join(0.02)

    def stop(self) -> None:
        """End a server that was started."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join(4 * GRACE)

    def _page(self) -> None:
        # pages that were never shown; each adds 3 ms to a collection of garbage, which halts the server
        Client.prune_instances(client_age_threshold=TIMEOUT)
        Page(self.session, self._stream, self.authority, self._training)

    @contextlib.asynccontextmanager
    async def _life(self, _: FastAPI) -> AsyncIterator[None]:
        """Run the watchdog and the stream of frames while the server runs."""
        async with watching(self.authority):
            showing = asyncio.create_task(self._stream.run())
            try:
                self._began()
                yield
            finally:
                showing.cancel()


async def _not_found(*_: object) -> Response:
    return Response("there is nothing at this address\n", 404, media_type="text/plain")


def bound(host: str, port: int) -> socket.socket:
    """A listening socket. Raises `Problem` if the address cannot be used."""
    listening = None
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except (OSError, OverflowError) as error:
        if listening is not None:
            listening.close()
        why = getattr(error, "strerror", None) or error
        message = f"--host {host} --port {port}: cannot listen: {why}; --port 0 selects a free port"
        raise Problem(message) from None
    return listening


def _displayed(host: str) -> str:
    """The host in the form used in a URL; for a wildcard address, the name of this computer."""
    if host in ("0.0.0.0", "::"):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


def quiet() -> None:
    """Do not log errors of pages that were closed while a message was on its way."""
    logging.getLogger("nicegui").setLevel(logging.ERROR)
    access.shorten_library_logs()


def serve(
    system: Path,
    replay: Path | None,
    pose: str,
    swap: Mapping[str, str],
    set_: Mapping[str, str],
    *,
    host: str,
    port: int,
    token: str,
    open_: bool,
    results: Path,
) -> None:
    """Serve until interrupted. Raises `Problem` for a mistake before anything is served."""
    first = MachineChoice(require_system(system), pose, swap, set_)
    make_folder(results)
    quiet()
    session = Session(first, RealTimeMachine, Replay, [results])
    try:
        if replay is not None:
            session.replay_file(replay)
        server = Server(session, host, port, token)

        def began() -> None:
            gc.freeze()  # what exists by now stays: a collection of garbage would halt the server for it
            print(f"{session.title}\n{server.url}\npress Ctrl-C to end", flush=True)
            if open_:  # in a thread, because on some systems the call waits for the browser
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()

        with failures_reported(session.live, session.save_live):
            server.run(began)
        raise KeyboardInterrupt  # uvicorn returns without it if SIGINT is ignored, as in a background job
    finally:
        session.close()
