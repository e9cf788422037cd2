"""`harvester view`, of which the first page drives at once: `python first_drives.py SYSTEM RESULTS`."""

import sys
from functools import partial
from pathlib import Path

from orchestrator.view import server
from orchestrator.view.authority import ControlAuthority, OperatorStation
from orchestrator.view.choice import MachineChoice


class Volunteering(ControlAuthority):
    """Gives the controls to whoever connects while they are free."""

    def join(self) -> OperatorStation:
        station = super().join()
        self.take(station)
        return station


if __name__ == "__main__":
    server.ControlAuthority = Volunteering
    where = {"host": "127.0.0.1", "port": 0, "token": "", "open_": False, "results": Path(sys.argv[2])}
    tell = partial(print, flush=True)
    server.serve(MachineChoice(Path(sys.argv[1])), None, **where, tell=tell, tell_failure=tell)
