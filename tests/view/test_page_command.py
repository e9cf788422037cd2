"""`harvester view` as a user runs it: where it listens, what it says, how it ends."""

import contextlib
import json
import os
import re
import signal
import zipfile
from functools import partial
from pathlib import Path

import httpx
import pytest
from kit.mistakes import refused, table
from kit.needs import needs
from kit.wait import LONG
from view.standin import URL, started
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

POSED = ("--pose", "reach", "--swap", "swing=detailed", "--set", "manipulator.head_mass=900")
RECORDING = "recording.csv"  # of a test rig, with names of its own
get = partial(httpx.get, timeout=LONG)
NONSENSE = (
    *("", "garbage", "[]", "{}", '{"do":null}', '{"do":"shown"}', '{"do":"choose","mode":"x"}'),
    *('{"do":"start","system":"x.ssp","pose":"","swap":{}}', '{"do":"set","name":"x","value":1}'),
    *('{"do":"save"' + "[" * 3000, "x" * 100_000, b"\x00" * 100_000, os.urandom(100)),
)
opened = partial(connect, compression=None, open_timeout=LONG, ping_timeout=None)


@needs("POSIX", "an interrupt of one process cannot be sent there")
def test_begins_and_ends(fmu_dir: Path, tmp_path: Path) -> None:
    """It tells its address, serves there, drops nonsense, and ends by an interrupt without a traceback."""
    with started(fmu_dir, tmp_path, *POSED) as (child, said):
        assert said[0] == "harvester.ssp, reach, swing detailed, manipulator.head_mass=900"
        assert said[URL].startswith("http://127.0.0.1:")
        assert get(said[URL], headers={"host": "evil.example"}).status_code == 400
        talk_nonsense(said[URL])
        assert get(said[URL]).status_code == 200
        child.send_signal(signal.SIGINT)
        _, told = child.communicate(timeout=LONG)
    assert child.returncode == 130
    assert "Traceback" not in told
    assert max(map(len, told.splitlines())) < 200


def talk_nonsense(url: str) -> None:
    """On the socket of a page."""
    for piece in NONSENSE:
        with contextlib.suppress(ConnectionClosed), opened(f"{url.replace('http', 'ws')}live") as socket:
            assert "hello" in json.loads(socket.recv(timeout=LONG))
            socket.send(piece)
            # until it was read, or the connection was closed over it
            assert socket.ping(ack_on_close=True).wait(LONG)


@needs("POSIX", "an interrupt of one process cannot be sent there")
def test_other_hosts_need_the_token(fmu_dir: Path, tmp_path: Path) -> None:
    """Where others could reach it, the page opens with the token of the address and not without; where nobody
    talked nonsense, its end is all that it reports."""
    with started(fmu_dir, tmp_path, "--host", "0.0.0.0") as (child, said):
        bare, _, token = said[URL].partition("?token=")
        port = bare.rstrip("/").rpartition(":")[2]
        assert len(token) >= 32
        assert get(f"http://127.0.0.1:{port}/").status_code == 401
        page = get(f"http://127.0.0.1:{port}/?token={token}", follow_redirects=True)
        assert page.status_code == 200
        child.send_signal(signal.SIGINT)
        _, told = child.communicate(timeout=LONG)
    assert (child.returncode, told) == (130, "harvester: interrupted\n")


@table(__file__, "mistakes", "options, expected")
def test_mistakes(
    fmu_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: str
) -> None:
    """A mistake is one line and exit status 2, before anything is served."""
    (tmp_path / RECORDING).write_text("time,u\n0,1\n1,2\n")
    options = [str(tmp_path / RECORDING) if option == RECORDING else option for option in options]
    common = ["view", fmu_dir / "harvester.ssp", "--no-open", "--port", "0", "--results", tmp_path]
    assert expected in refused(capsys, [*common, *options])


def test_a_swap_that_the_controller_cannot_use_is_offered_without_it(
    fmu_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An FMU without the pressures that the controller measures: the message names the other system."""
    (tmp_path / "build").symlink_to(fmu_dir, target_is_directory=True)
    own = tmp_path / "own.fmu"
    with zipfile.ZipFile(fmu_dir / "boom_stick.fmu") as old, zipfile.ZipFile(own, "w") as new:
        for name in old.namelist():
            new.writestr(name, re.sub(rb'name="(\w+_(head|rod)_pressure)"', rb'name="my_\1"', old.read(name)))
    monkeypatch.chdir(tmp_path)
    told = refused(capsys, ["view", "--no-open", "--swap", "boom_stick=own.fmu"])
    assert "expected output boom_head_pressure [Pa], got none" in told
    offer = "build/harvester.ssp has no controller and accepts it: harvester view build/harvester.ssp --swap"
    assert told.endswith(f"{offer} boom_stick=own.fmu\n")
