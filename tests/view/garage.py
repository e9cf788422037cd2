"""A toy with a diagnosis, whose inputs are what it finds, and a scale, which has none."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from kit.toy import toy

from fmus.contract import Quantity, Subsystem
from fmus.export.build import build
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

STATE = "%s: 1 a fault (%s), 0 none, -1 cannot be told"
REPAIRS = {"leak": "hose_one (left)", "heat": "cooler", "switch": "<i>switch</i>", "speed": "none"}
SIZES = {
    "leak": Quantity("m2", "opening of hose_one at 60 degC", 1e-6),
    "heat": Quantity("K", "Temperature of the oil"),
    "switch": Quantity("1", "1: the <b>switch</b> does not close"),
}
DEVIATIONS = {"leak": 2e-7, "heat": 2.0, "switch": 0.0}
BLANK = {"view.toml": b"gauges = []\ncharts = []"}


def still(*_: Any) -> dict[str, Any]:
    """Nothing changes by itself."""
    return {"x": 0}


def garage() -> Subsystem:
    """Sizes and states are its inputs; its load has no state, its speed has no deviation."""
    outputs = dict(SIZES) | {f"{n}_deviation": q.unit for n, q in SIZES.items()}
    outputs |= {f"{n}_state": Quantity("1", STATE % (n, repair)) for n, repair in REPAIRS.items()}
    outputs |= {"load": Quantity("kg", "Load", 100.0), "load_deviation": "kg", "speed": "m/s"}

    def observe(_x: Any, u: Any, _p: Any) -> dict[str, Any]:
        found = {f"{n}_deviation": d for n, d in DEVIATIONS.items()}
        for n in SIZES:
            found |= {n: getattr(u, f"{n}_now"), f"{n}_state": getattr(u, f"{n}_judged")}
        return found | {"load": 200, "load_deviation": u.blur, "speed": u.reset, "speed_state": 1}

    inputs = {f"{n}_now": q.unit for n, q in SIZES.items()} | {f"{n}_judged": "1" for n in SIZES}
    inputs |= {"blur": "kg", "reset": "1"}
    return toy("garage", {}, {"x": "1"}, inputs, outputs, still, observe)


def scale() -> Subsystem:
    """A weight with a deviation, in an FMU without findings."""

    def weigh(_x: Any, u: Any, _p: Any) -> dict[str, Any]:
        return {"weight": u.now, "weight_deviation": u.reset}

    outputs = {"weight": "kg", "weight_deviation": "kg"}
    return toy("scale", {}, {"x": "1"}, {"now": "kg", "reset": "1"}, outputs, still, weigh)


def system(folder: Path, resources: Mapping[str, bytes] = BLANK) -> Path:
    """Both, without connections; by default without sliders."""
    fmus = {sub.name: build(replace(sub, values=None, numbers={}), folder) for sub in (garage(), scale())}
    made = assemble(fmus, (), name="workshop", stop=1000.0, step=1e-3)
    return write_ssp(made, folder / "workshop.ssp", resources=resources)
