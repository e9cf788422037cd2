"""The web server of the view: one session and any number of pages, behind access control.

The page is static (`orchestrator.drive.page.served`). Each open page has one websocket (`live`).
"""

import asyncio
import contextlib
import socket
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder
from orchestrator.drive.page import served
from orchestrator.pages.html_page import json_values
from orchestrator.realtime.machine import failures_reported
from orchestrator.view import access
from orchestrator.view.access import Guard, rules
from orchestrator.view.authority import ControlAuthority
from orchestrator.view.choice import MachineChoice
from orchestrator.view.live import Pages
from orchestrator.view.result_files import find_result
from orchestrator.view.server_load import REQUESTS, TimedConnection
from orchestrator.view.session import Session

TITLE = "Harvester"
LOOPBACK = "127.0.0.1"
SHORTEST = 16  # characters of a chosen token, at least
LARGEST = 2**16  # bytes of one message of a browser; ordinary messages are far smaller
GRACE = 2  # s for open connections at the end
WATCH = 0.05  # s between two checks of the watchdog


class Server:
    """Serves a session.

    url         address of the page, with the token if one is required
    authority   decides which page drives the machine
    """

    def __init__(self, session: Session, host: str = LOOPBACK, port: int = 0, token: str = "") -> None:
        """port: 0 selects a free one; token: by default random, if `host` is not a loopback address."""
        if token and len(token) < SHORTEST:
            raise Problem(f"--token: expected at least {SHORTEST} characters, got {len(token)}")
        self.session = session
        self.authority = ControlAuthority(session.machine, lambda: session.plan.description)
        self._socket = bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        allowed = rules(host, (_displayed(host),), self.port, token)
        query = f"?token={allowed.token}" if allowed.token else ""
        self.url = f"http://{_displayed(host)}:{self.port}/{query}"
        app = application(Pages(session, self.authority), lambda: self._began())
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


def application(pages: Pages, began: Callable[[], object] = lambda: None) -> Starlette:
    """The page and its websocket, without access control. began: called when it serves."""
    files = {path: (kind, text.encode()) for path, (kind, text) in served(TITLE).items()}

    async def file(request: Request) -> Response:
        kind, content = files[request.url.path]
        return Response(content, media_type=kind, headers={"Cache-Control": "no-cache"})

    async def result(request: Request) -> Response:
        try:
            path = find_result(request.path_params["name"], pages.session.folders)
        except Problem as problem:
            return Response(f"{problem}\n", 404, media_type="text/plain")
        return FileResponse(path, filename=path.name)

    def recording(request: Request) -> Response:
        try:
            data = pages.session.recording(request.path_params["name"])
        except Problem as problem:
            return Response(f"{problem}\n", 404, media_type="text/plain")
        return JSONResponse(json_values(data))

    async def watch() -> None:
        while True:
            pages.authority.check()
            await asyncio.sleep(WATCH)

    @contextlib.asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        """Run the watchdog and read the machine while the server runs. At the end the machine rests."""
        tasks = [asyncio.create_task(watch()), asyncio.create_task(pages.run())]
        try:
            began()
            yield
        finally:
            for task in tasks:
                task.cancel()
            pages.authority.stop()

    routes: list[BaseRoute] = [Route(path, file) for path in files]
    routes += [Route("/result/{name:path}", result), Route("/recording/{name:path}", recording)]
    routes += [WebSocketRoute("/live", pages.serve)]
    return Starlette(routes=routes, lifespan=life, exception_handlers={404: _not_found})


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


def serve(
    first: MachineChoice,
    replay: Path | None,
    *,
    host: str,
    port: int,
    token: str,
    open_: bool,
    results: Path,
    tell: Callable[[str], object],
    tell_failure: Callable[[str], object],
) -> None:
    """Serve until interrupted. Raises `Problem` for a mistake before anything is served.

    tell          called with what is served and where, when the server accepts connections
    tell_failure  called with each failure of the machine
    """
    make_folder(results)
    access.shorten_library_logs()
    session = Session(first, [results], file=replay)
    try:
        if replay is not None:
            session.recording("")  # raises Problem for a file that cannot be replayed
            session.machine.pause()
        server = Server(session, host, port, token)
        address = server.url
        if replay is not None:
            address += f"{'&' if '?' in address else '?'}replay="

        def began() -> None:
            tell(f"{replay or session.title}\n{address}\npress Ctrl-C to end")
            if open_:  # in a thread, because on some systems the call waits for the browser
                threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

        with failures_reported(session.machine, session.save, tell_failure):
            server.run(began)
        raise KeyboardInterrupt  # uvicorn returns without it if SIGINT is ignored, as in a background job
    finally:
        session.close()
