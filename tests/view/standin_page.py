"""The page of a machine without physics, for a browser: `python standin_page.py PORT`."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import uvicorn
from starlette.requests import Request
from starlette.responses import JSONResponse
from view.standin import DESCRIPTION, StandIn, pages

from orchestrator.view.access import Guard, rules
from orchestrator.view.authority import ControlAuthority
from orchestrator.view.server import application

FIRST = dict.fromkeys(DESCRIPTION.task.needed, 0.0) | {"tip_x": 4.3}


@dataclass
class Machine(StandIn):
    """Notes who had the controls when it came to rest last; empty: nobody."""

    rested: str = ""
    driver: Callable[[], str] = str

    def command(self, values: Mapping[str, float]) -> None:
        if self.moving and not any(values.values()):
            self.rested = self.driver()
        super().command(values)


class Counting(ControlAuthority):
    """Counts the accepted messages of all pages, also of those that are closed."""

    heard = 0

    def hear(self, *arguments: object) -> bool:
        accepted = super().hear(*arguments)
        self.heard += accepted
        return accepted


def main(port: int) -> None:
    machine = Machine(signals=tuple(FIRST), frames=[(0.0, [*FIRST.values()])])
    # a computer that does much else may halt for some seconds: that is no driver who went away
    authority = Counting(machine, lambda: DESCRIPTION, silence_limit=6.0)
    machine.driver = lambda: authority.status().driver
    app = application(pages(machine, authority))

    async def last(_: Request) -> JSONResponse:
        known = {"command": machine.commands[-1:], "rested": machine.rested, "heard": authority.heard}
        known["pid"] = os.getpid()
        return JSONResponse(known | asdict(authority.status()))

    app.add_route("/last", last)
    app.add_middleware(Guard, rules=rules("127.0.0.1"))
    uvicorn.run(app, host="127.0.0.1", port=port, log_level="error", ws="websockets-sansio")


main(int(sys.argv[1]))
