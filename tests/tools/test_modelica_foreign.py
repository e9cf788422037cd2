"""`harvester modelica` with FMUs of other tools: names, types of parameters, values of an SSP, faults while they run.

decay.c is a first-order lag: dx/dt = s n (u - k x), x(0) = 1.
"""

import os
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kit import shards
from kit.any_fmu.description import Description, V, member, packed
from kit.compile import library
from kit.mistakes import problem, table
from kit.openmodelica import openmodelica

from orchestrator.__main__ import main
from orchestrator.modelica import write_package

SOURCE = Path(__file__).with_name("decay.c")
SYSTEM = SOURCE.with_suffix(".ssd")
VARIABLES = [
    V("k", "parameter", start=1, more='max="INF"', place=0),
    V("n", "parameter", start=1, kind="Integer", place=0),
    V("fault", "parameter", start=0, kind="Integer", place=1),
    V("flip", "parameter", start=False, kind="Boolean", place=0),
    V("mode", "parameter", start="single", kind="String", place=0),
    V("u", "input", start=0, place=1),
    V("x", "local", start=1, exact=True, place=2),
    V("der(x)", "local", depends=["u", "x"], derives="x", place=3),
    V("y", "output", depends=["x"], place=4),
]
TIGHT = 1e-6  # relative, for DASSL at 1e-9 over one time constant
PLAIN_GUID, OTHER_GUID = ('guid="decay"', 'guid="first"'), ('guid="decay"', 'guid="second"')
DISCARDED = r"T\.a: fmi2\w+ was discarded"  # a solver would go on with other numbers: exp(-0.5), not exp(-1)
Make = Callable[..., Path]


@pytest.fixture
def decay(tmp_path: Path) -> Make:
    """Makes the FMU under a name, with changed texts in its model description."""

    def make(name: str = "decay", *changes: tuple[str, str]) -> Path:
        text = Description("decay", VARIABLES, {"ModelExchange": {}}).text(2)
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        binary = library("decay", [SOURCE], "-std=c11", "-Wno-unused-parameter")
        members = {"modelDescription.xml": text, member(2, "decay"): binary}
        return packed(tmp_path / f"{name}.fmu", members)

    return make


def ssd(folder: Path, name: str, k: float) -> Path:
    """Two lags in a row, the first one with values of its own."""
    path = folder / f"{name}.ssd"
    text = SYSTEM.read_text(encoding="utf-8")
    path.write_text(text.replace("NAME", name).replace('"K"', f'"{k:g}"'), encoding="utf-8")
    return path


def simulate(folder: Path, packages: list[str], text: str) -> tuple[str, pd.DataFrame]:
    """What OpenModelica prints, and the rows of model T over 1 s; none where it fails."""
    loads = "".join(f'loadFile("{name}/package.mo"); getErrorString();\n' for name in packages)
    (folder / "T.mo").write_text(text, encoding="utf-8")
    (folder / "run.mos").write_text(
        f'loadModel(Modelica, {{"4.0.0"}});\n{loads}loadFile("T.mo"); getErrorString();\n'
        'simulate(T, stopTime = 1, tolerance = 1e-9, outputFormat = "csv"); getErrorString();\n',
        encoding="utf-8",
    )
    (folder / "T_res.csv").unlink(missing_ok=True)
    said = openmodelica(folder / "run.mos")
    failed = "The simulation finished successfully" not in said
    return said, pd.DataFrame() if failed else pd.read_csv(folder / "T_res.csv")


def at_end(folder: Path, packages: list[str], text: str) -> pd.Series:
    """Values at 1 s."""
    said, rows = simulate(folder, packages, text)
    assert not rows.empty, said
    return rows.iloc[-1]


@shards.tools
def test_parameters_of_every_type_and_inputs_reach_the_fmu(decay, tmp_path):
    """Real, integer, boolean and text, and the start value of the state, each as a parameter of the block.

    f refuses to begin with u = 0: inputs are set before the initialisation ends. Blocks of two packages serve one
    model, because their C functions have names of their own; the folder may have spaces and letters of any kind.
    """
    folder = tmp_path / "Übung 100%"
    write_package([decay()], folder, "One")
    write_package([decay("lag", PLAIN_GUID)], folder, "Two")
    end = at_end(
        folder,
        ["One", "Two"],
        'model T One.FMUs.Decay a(k = 0.5), b(n = 3), c(flip = true), d(mode = "double"), e(x_start = 4);\n'
        "One.FMUs.Decay f(fault = 4); Two.FMUs.Lag g;\n"
        "equation a.u = 0; b.u = 0; c.u = 0; d.u = 0; e.u = 0; f.u = 2; g.u = 0; end T;",
    )
    expected = {"a": np.exp(-0.5), "b": np.exp(-3), "c": np.exp(1), "d": np.exp(-2), "e": 4 * np.exp(-1)}
    expected |= {"f": 2 - np.exp(-1), "g": np.exp(-1)}
    assert {name: end[f"{name}.y"] for name in expected} == pytest.approx(expected, rel=TIGHT)


@shards.tools
def test_names_that_modelica_does_not_take_are_quoted_and_stay_apart(decay, tmp_path):
    """Of variables, files, components; a start value gives way to a parameter of its name."""
    names = ('"k"', '"end"'), ('"u"', '"arm.force[1]"'), ('"y"', '"sum"'), ('"n"', '"x_start"')
    odd = decay("1st-decay.x", *names)
    write_package([odd, decay("boom-stick", PLAIN_GUID), decay("boom_stick", OTHER_GUID)], tmp_path, "P")
    end = at_end(
        tmp_path,
        ["P"],
        "model T P.FMUs.'1st-decay.x' a('end' = 0.5, x_start = 2, x_start_ = 3);\n"
        "P.FMUs.BoomStick b; P.FMUs.BoomStick_ c;\n"
        "equation a.'arm.force[1]' = 0; b.u = 0; c.u = 0; end T;",
    )
    assert end["a.'sum'"] == pytest.approx(3 * np.exp(-0.5 * 2), rel=TIGHT)


@shards.tools
def test_a_system_has_the_values_of_its_ssp(decay, tmp_path):
    """Systems of the same FMU: each with its own, blocks with those of the FMU.

    An open input has its start value, or the value in a model that extends the system.
    """
    decay()
    systems = [ssd(tmp_path, name, k) for name, k in (("slow", 0.1), ("fast", 0.2), ("open", 1.0))]
    write_package(systems, tmp_path, "P")
    end = at_end(
        tmp_path,
        ["P"],
        "model T extends P.Systems.Open('left arm_u' = 1);\n"
        "P.Systems.Slow slow; P.Systems.Fast fast; P.FMUs.Decay own; equation own.u = 0; end T;",
    )
    assert end["slow.'left arm'.y"] == pytest.approx(np.exp(-0.3), rel=TIGHT)
    assert end["fast.'left arm'.y"] == pytest.approx(np.exp(-0.6), rel=TIGHT)
    assert end["'left arm'.y"] == pytest.approx(1.0, rel=TIGHT)  # x = 1 is at rest with u = 1
    assert end["own.y"] == pytest.approx(np.exp(-1), rel=TIGHT)


@shards.tools
@pytest.mark.parametrize(
    ("fault", "message"),
    [(1, DISCARDED), (2, DISCARDED), (3, "T.a: the FMU requests the end of the simulation")],
    ids=["derivatives", "states", "end"],
)
def test_what_the_fmu_discards_or_ends_is_the_end_of_the_run(decay, tmp_path, fault, message):
    """The message has the name of the block and the reason."""
    write_package([decay()], tmp_path, "P")
    model = f"model T P.FMUs.Decay a(fault = {fault}); equation a.u = 0; end T;"
    said, rows = simulate(tmp_path, ["P"], model)
    assert rows.empty
    assert re.search(message, said)


def test_equal_fmus_are_one_block_with_two_names(decay, tmp_path):
    """A variant with the same model description is available under its own name, too."""
    text = write_package([decay(), decay("usual")], tmp_path, "P").read_text(encoding="utf-8")
    assert "block Usual = Decay;" in text
    assert [p.name for p in (tmp_path / "P" / "Resources" / "FMUs").iterdir()] == ["decay"]


def test_a_file_that_was_added_or_changed_is_not_lost(decay, tmp_path):
    """The command refuses to write over it and names it."""
    package = write_package([decay()], tmp_path, "P")
    added = package.parent / "Mine.mo"
    added.write_text("within P; model Mine end Mine;")
    told = problem(lambda: write_package([decay()], tmp_path, "P"))
    assert told.endswith("Mine.mo was added by hand: move the package, or choose another name")
    added.unlink()
    package.write_text(package.read_text(encoding="utf-8") + "// mine", encoding="utf-8")
    problem(lambda: write_package([decay()], tmp_path, "P"), r"package\.mo was changed by hand")
    assert package.read_text(encoding="utf-8").endswith("// mine")


def test_a_package_stays_when_the_next_one_cannot_be_written(decay, tmp_path):
    """An archive with a member outside of it is found while the FMUs are unpacked."""
    package = write_package([decay()], tmp_path, "P")
    before = package.read_text(encoding="utf-8")
    slip = decay("slip", PLAIN_GUID)
    with zipfile.ZipFile(slip, "a") as archive:
        archive.writestr("../outside", "")
    problem(lambda: write_package([slip], tmp_path, "P"), r"has '\.\.' in its path, expected none")
    assert package.read_text(encoding="utf-8") == before
    assert os.listdir(tmp_path / "P" / "Resources" / "FMUs") == ["decay"]
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_an_unpacked_fmu_is_copied(decay, tmp_path):
    """A folder instead of an archive, also one in the package that is replaced."""
    write_package([decay()], tmp_path, "P")
    inside = tmp_path / "P" / "Resources" / "FMUs" / "decay"
    again = write_package([inside], tmp_path, "P")
    assert (inside / "modelDescription.xml").is_file()
    assert "block Decay " in again.read_text(encoding="utf-8")


@table(__file__, "refused", "old, new, reason")
def test_an_fmu_that_cannot_be_a_block_is_refused(decay, tmp_path, old, new, reason):
    """In one line with the file and the reason."""
    told = problem(lambda: write_package([decay("decay", (old, new))], tmp_path, "P"))
    assert told.endswith(f"decay.fmu: {reason}")
    assert not (tmp_path / "P").exists()


def test_invalid_names_are_reported(decay, tmp_path):
    """The name of the package, and an input that no FMU has."""
    fmus = [decay()]
    for name in ("1st", "Übung", "Modelica"):
        told = problem(lambda name=name: write_package(fmus, tmp_path, name))
        assert f"package name '{name}': expected letters, digits and _" in told
    problem(lambda: write_package(fmus, tmp_path, "P", ("nosuch",)), "no FMU has an input 'nosuch'")


def test_the_command_takes_any_fmu(decay, tmp_path, capsys):
    """Its inputs that stay constant by default are those of the machine, which this FMU does not have."""
    assert main(["modelica", str(decay()), "--out", str(tmp_path), "--name", "Mine"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == str(tmp_path / "Mine" / "package.mo")
