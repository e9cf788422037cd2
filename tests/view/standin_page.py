"""A page with nothing but the controls and the task, for a browser: `python standin_page.py PORT`."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from nicegui import app, ui
from view.standin import MODES, StandIn

from orchestrator.view.access import Guard, rules
from orchestrator.view.driving import endpoint
from orchestrator.view.authority import ControlAuthority, OperatorStation
from orchestrator.drive.score import NEEDED
from orchestrator.view.training import Training
from orchestrator.view.training import mount as mount_task

FIRST = dict.fromkeys(NEEDED, 0.0) | {"tip_x": 4.3}


@dataclass
class Machine(StandIn):
    """Notes who had the controls when it came to rest last; empty: nobody."""

    rested: str = ""
    driver: Callable[[], str] = str

    def command(self, values: Mapping[str, float]) -> None:
        if self.moving and not any(values.values()):
            self.rested = self.driver()
        super().command(values)


def main(port: int) -> None:
    machine = Machine(signals=tuple(FIRST), frames=[(0.0, [*FIRST.values()])])
    # a computer that does much else may halt for some seconds: that is no driver who went away
    authority, training = ControlAuthority(machine, lambda: MODES, silence_limit=6.0), Training(machine)
    machine.driver = lambda: authority.status().driver
    stations: list[OperatorStation] = []
    endpoint.serve(app, authority)
    watchdog = endpoint.watching(authority)
    app.on_startup(watchdog.__aenter__)
    app.on_shutdown(lambda: watchdog.__aexit__(None, None, None))
    app.add_middleware(Guard, rules=rules("127.0.0.1"))

    @app.get("/last")
    def last() -> dict[str, Any]:
        heard = sum(station.counts["accepted"] for station in stations)
        known = {"command": machine.commands[-1:], "rested": machine.rested, "heard": heard}
        return known | vars(authority.status())

    @ui.page("/")
    def page() -> None:
        stations.append(endpoint.mount(machine, authority))
        ui.input("field")
        mount_task(training)
        ui.html("<div style='height: 3000px'></div>", sanitize=False)

    ui.run(host="127.0.0.1", port=port, show=False, reload=False, show_welcome_message=False)


main(int(sys.argv[1]))
