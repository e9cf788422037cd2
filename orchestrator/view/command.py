"""`harvester view`: a machine, a server, and a clean end."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path

from orchestrator.base.files import folder, there
from orchestrator.view.choice import Choice
from orchestrator.view.session import Session


def view(
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
    """Serve until interrupted. A mistake is told before anything is served."""
    from orchestrator.realtime.machine import Station
    from orchestrator.realtime.replay import Replay
    from orchestrator.view.server import Server, quiet

    first = Choice(there(system), pose, swap, set_)
    folder(results)
    quiet()
    session = Session(first, Station, Replay, [results])
    try:
        if replay is not None:
            session.replay_file(replay)
        server = Server(session, host, port, token)

        def began() -> None:
            print(f"{session.title}\n{server.url}\nCtrl-C ends it", flush=True)
            if open_:  # aside: some systems wait here for the browser to end
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()

        server.run(began)
        raise KeyboardInterrupt  # the server ends without one where its signal is ignored, as behind a script
    finally:
        session.close()
