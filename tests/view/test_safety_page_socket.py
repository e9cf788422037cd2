"""The socket of the page itself, which is the library's: nonsense there does not stop the server."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import httpx
import pytest
from view.standin import LONG
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

SOCKET = "_nicegui_ws/socket.io/?EIO=4"
NONSENSE = (
    *("", "garbage", "9", "42", "42[", "42{}", "42[]", '42["event"]', '42["event",null]', '42["event",{}]'),
    *(
        '42["handshake",{}]',
        '42["handshake",{"client_id":"x","tab_id":"y"}]',
        '42["ack",{"client_id":1e999}]',
    ),
    *('42["javascript_response",{"client_id":"x","request_id":"y"}]', '42["log",null]', "42" + "[" * 30_000),
    *('451-["event",{"_placeholder":true,"num":0}]', '459999999-["event"]', '0{"sid":1}', "2probe"),
    *("x" * 100_000, b"\x00" * 100_000, os.urandom(100)),
)

opened = partial(connect, compression=None, open_timeout=LONG, ping_timeout=None)


@pytest.fixture(scope="module")
def served(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, subprocess.Popen]]:
    """The address of the real server, in a process of its own."""
    command = [sys.executable, "-m", "orchestrator", "view", str(fmu_dir / "harvester.ssp"), "--no-open"]
    command += ["--port", "0", "--results", str(tmp_path_factory.mktemp("results"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        said = [child.stdout.readline().strip() for _ in range(3)]
        yield said[1], child
        child.kill()


@pytest.mark.skipif(sys.platform == "win32", reason="an interrupt of one process cannot be sent there")
def test_nonsense(served: tuple[str, subprocess.Popen]) -> None:
    """Each piece is dropped, the page is served afterwards, and the end is as usual, without tracebacks."""
    url, child = served
    for piece in NONSENSE:
        address = f"{url.replace('http', 'ws')}{SOCKET}&transport=websocket"
        with contextlib.suppress(ConnectionClosed), opened(address) as socket:
            socket.recv(timeout=LONG)
            socket.send("40" + json.dumps({}))
            socket.send(piece)
            # until it was read, or the connection was closed over it
            assert socket.ping(ack_on_close=True).wait(LONG)
    for piece in (b"garbage", b"\x1e" * 10, b"x" * 2_000_000):
        assert httpx.post(f"{url}{SOCKET}&transport=polling", content=piece, timeout=LONG).status_code == 405
    assert httpx.get(f"{url}{SOCKET}&transport=polling", timeout=LONG).status_code == 400
    refused = pytest.raises(InvalidStatus, match="403")
    with refused, opened(address, origin="http://evil.example"):
        pass
    assert httpx.get(url, timeout=LONG).status_code == 200
    child.send_signal(signal.SIGINT)
    _, told = child.communicate(timeout=LONG)
    assert child.returncode == 130
    assert "Traceback" not in told
    assert max(map(len, told.splitlines())) < 200
