"""Models by hand: what is refused at the build, and what is told while they run. Each fault in one line."""

import sys
from pathlib import Path
from runpy import run_path

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from kit.fmu import Fmu, driving, in_new_process
from kit.mistakes import problem, refused, table

from fmus.boom_stick import BOOM_STICK
from fmus.contract import quantities
from fmus.export.build import build
from fmus.export.python import subgroup
from fmus.export.python.build import build_user
from orchestrator.__main__ import main
from python_fmu.lag import built, written

OBSERVE = "return Outputs(y=x.y, z=x.y + u.w)"
STEP = "return State(y=x.y + h * (GAIN * u.u - x.y) / p.delay)"
BY_HAND = "        "
NATIVE = Path(__file__).with_name("lag_of_equations.txt").read_text(encoding="utf-8")
THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from kit.fmu import Fmu
with ThreadPoolExecutor(4) as pool:
    for fmu in pool.map(lambda _: Fmu(Path(sys.argv[1])).start(), range(4)):
        print(round(float(fmu.step(1e-3)["y"]), 12))
"""


def fault(where: str, *lines: str) -> tuple[str, str]:
    """Lines before the return of a method."""
    return where, f"\n{BY_HAND}".join([*lines, where])


@pytest.mark.parametrize("fmi", [2, 3])
def test_it_is_a_lag(tmp_path, fmi):
    """Input, rate port, output and warning have the values that the model defines."""
    path = built(tmp_path, fmi=fmi)
    assert validate_fmu(str(path)) == []
    with driving(path, u=1.0, u_rate=2.0, w=0.5) as fmu:
        fmu.step(0.01)
        y = 0.01 * (1.0 + 2.0 * 0.005) / 0.1  # u in the middle of the step
        assert fmu.get("u", "y", "z") == pytest.approx([1.02, y, y + 0.5], rel=1e-15)  # the same operations
        fmu.refuses(lambda: fmu.output_slopes("z"), "a model written by hand has no derivatives")


def test_the_description_is_complete(tmp_path):
    """Units, bounds, start values, causality and dependencies are as declared."""
    description = read_model_description(str(built(tmp_path)))
    v = {variable.name: variable for variable in description.modelVariables}
    assert [v[n].causality for n in ("delay", "u", "y", "z")] == ["parameter", "input", "output", "output"]
    assert (v["delay"].unit, v["delay"].min, v["delay"].variability) == ("s", "0.001", "tunable")
    assert (v["u"].start, v["w"].start, v["y"].start, v["z"].start) == ("1", "0", "0", None)
    depends = {u.variable.name: [d.name for d in u.dependencies] for u in description.outputs}
    assert depends == {"y": [], "z": ["w"]}
    first = {u.variable.name: {d.name for d in u.dependencies} for u in description.initialUnknowns}
    assert first == {"z": {"w", "delay", "y"}}


@table(__file__, "build", "old, new, expected")
def test_the_build_refuses(tmp_path, old, new, expected):
    """A file that does not work or violates its declarations is refused."""
    (tmp_path / "other.py").write_text("GAIN = 2.0\n", encoding="utf-8")
    line = problem(lambda: built(tmp_path, (old, new)))
    assert line.startswith("lag.py:")
    assert expected in line
    assert not (tmp_path / "out").exists()


def test_helpers_of_any_name_are_the_users_own(tmp_path):
    """A name close to one of another kind is no slip, nor is a model without state and step."""
    own = "t_start, restart, file, filters, parameter, required, step_s = 0.0, True, 'a', [1], 2.0, True, 1"
    assert built(tmp_path, ("    start =", f"    {own}\n    start =")).is_file()
    assert built(tmp_path, ("    start =", "    steps, _state, flows = 3, 4, 5\n    start =")).is_file()
    head = written(tmp_path).read_text(encoding="utf-8").partition("class Lag")[0]
    observe = "    def observe(self, x, u, p, t):\n        return Outputs(y=u.u, z=u.w)\n"
    text = f"{head}class Sum(Model):\n    Inputs, Outputs = Inputs, Outputs\n\n{observe}"
    (tmp_path / "sum.py").write_text(text, encoding="utf-8")
    assert build_user(tmp_path / "sum.py", tmp_path / "out").is_file()


@table(__file__, "allowed", "old, new")
def test_methods_and_numbers_of_any_origin(tmp_path, old, new):
    """A method may need no instance or be assigned; numbers may be those of NumPy."""
    assert built(tmp_path, (old, new), ("GAIN = 1.0", "import numpy as np\n\nGAIN = 1.0")).is_file()


def test_a_folder_and_a_missing_file_are_named(tmp_path):
    """What is no file is refused with its path."""
    (tmp_path / "folder.py").mkdir()
    kinds = {"nothing": "no such file", "folder": "expected a file, got a folder"}
    for name, told in kinds.items():
        file = tmp_path / f"{name}.py"
        problem(lambda file=file: build_user(file, tmp_path / "out"), f"{name}.py: {told}")


@table(__file__, "equations", "old, new, expected")
def test_a_mistake_in_equations_is_one_line(tmp_path, old, new, expected):
    """File, line and function of a user's subsystem, by the function that builds it."""
    assert old in NATIVE
    (tmp_path / "native.py").write_text(NATIVE.replace(old, new), encoding="utf-8")
    line = problem(lambda: build(run_path(str(tmp_path / "native.py"))["LAG"], tmp_path / "out"))
    assert expected in line
    assert not (tmp_path / "out").exists()


def test_the_command_builds_no_subsystem(capsys, tmp_path):
    """By the name of a subsystem, as until version 0.1, or by its file: the line says what builds it."""
    line = refused(capsys, ["build", "fmus.boom_stick:VARIANTS.lumped"])
    assert "lumped: expected a file such as my_actuator.py; fmus.build(...) builds one of equations" in line
    (tmp_path / "lag.py").write_text(NATIVE, encoding="utf-8")
    told = problem(lambda: build_user(tmp_path / "lag.py", tmp_path / "out"))
    assert "got none; LAG is a Subsystem: build it by fmus.build(LAG, folder)" in told


def test_a_state_hidden_in_a_list_is_found(tmp_path):
    """The build refuses a model with hidden state, because repeated steps differ."""
    hidden = ("GAIN = 1.0", "GAIN, LOG = 1.0, []"), fault(STEP, "LOG.append(h)", "h = h * len(LOG)")
    problem(lambda: built(tmp_path, *hidden), "steps repeated from a saved state give different values")


def test_a_file_that_is_read_goes_along(tmp_path):
    """Files in `files` are in the FMU; the build fails if the model reads another file."""
    text = "from pathlib import Path\nGAIN = float(Path(__file__).with_name('gain.txt').read_text())"
    reading = "GAIN = 1.0", text
    written(tmp_path)
    (tmp_path / "gain.txt").write_text("3.0", encoding="utf-8")
    problem(lambda: built(tmp_path, reading), r"lag.py:9: FileNotFoundError: .*gain.txt")
    path = built(tmp_path, reading, ('start = {"u"', 'files = ("gain.txt",)\n    start = {"u"'))
    (tmp_path / "gain.txt").unlink()
    with driving(path) as fmu:
        assert fmu.step(0.01)["y"] == pytest.approx(0.3)


def test_a_point_where_the_model_does_not_work_says_nothing(tmp_path):
    """The check of dependencies skips points at which the model is undefined."""
    root = fault(OBSERVE, "import math; math.sqrt(1.005 - u.u)")
    assert built(tmp_path, root).is_file()


def test_a_file_in_the_root_of_a_checkout_is_no_neighbour(tmp_path):
    """The package next to the file is not a forbidden import."""
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus" / "__init__.py").touch()
    assert built(tmp_path).is_file()


def test_the_command_line_overwrites_no_native_fmu(tmp_path, capsys):
    """A model with the name of a part is written to a subfolder, for both versions of FMI."""
    file, native = written(tmp_path, name="swing.py"), tmp_path / "build" / "swing.fmu"
    native.parent.mkdir()
    native.write_text("native", encoding="utf-8")
    command = ["build", str(file), "--out", str(native.parent)]
    assert main(command) == 0
    paths = [native.parent / folder / "swing.fmu" for folder in ("python", "fmi3/python")]
    assert capsys.readouterr().out.splitlines() == [str(path) for path in paths]
    assert [read_model_description(str(path)).fmiVersion for path in paths] == ["2.0", "3.0"]
    assert native.read_text(encoding="utf-8") == "native"


def test_ports_are_taken_from_the_part_that_a_model_stands_for():
    """Variables have the requested order and their units; for an unknown name a similar one is suggested."""
    names, known = ("stick_force", "boom_force"), quantities(BOOM_STICK.outputs)
    group = quantities(subgroup("Own", BOOM_STICK.outputs, *names))
    assert dict(group) == {n: known[n] for n in names}
    told = problem(lambda: subgroup("Own", BOOM_STICK.outputs, "boom_forces"))
    assert told.startswith("Own: Outputs has no boom_forces, expected a name such as boom_force")


@table(__file__, "step", "lines, message")
def test_a_step_that_fails_says_why(tmp_path, capsys, lines, message):
    """File, line and fault in one message by the FMI logger; status error; the program goes on."""
    with driving(built(tmp_path, fault(STEP, *lines.splitlines()))) as fmu:
        fmu.set(w=2.0).refuses(lambda: fmu.step(1e-3), f"fmi2DoStep: {message}")
    assert capsys.readouterr().out.count("\n") == 1


@pytest.mark.parametrize("where", [STEP, "return {}"], ids=["step", "start"])
def test_an_interrupt_reaches_the_program(tmp_path, capsys, where):
    """An interrupt is reported in a message and passed on to the program."""
    initial = "\n    def initial(self, x, u, p):\n        return {}\n"
    change = fault(where, "if u.w == 2: raise KeyboardInterrupt")
    path = built(tmp_path, ("    def step(self", initial + "\n    def step(self"), change)
    fmu = Fmu(path)
    with pytest.raises(KeyboardInterrupt):
        fmu.start(w=2.0).step(1e-3)
    fmu.fmu.freeInstance()
    assert ": interrupted by the user" in capsys.readouterr().out


def test_variables_that_differ_from_the_build_are_refused(tmp_path, monkeypatch):
    """A model whose groups follow its environment: an error, because the library has other arrays."""
    last, more = "warn_above=100.0)]", "more: Annotated[float, Quantity('N', 'Another')] = 0.0"
    choice = f"\n    if __import__('os').environ.get('MORE'):\n        {more}"
    path = built(tmp_path, (last, last + choice))
    monkeypatch.setenv("MORE", "1")
    fmu = Fmu(path)
    fmu.refuses(fmu.start, "other variables than at its build")
    fmu.close()


def test_files_of_one_name_live_together(tmp_path):
    """Two models in files of the same name, built in one process and loaded together: each keeps its own."""
    one = built(tmp_path / "a", name="model.py")
    two = built(tmp_path / "b", ("GAIN = 1.0", "GAIN = -1.0"), name="model.py")
    assert one.name == two.name == "model.fmu"
    with driving(one) as first, driving(two) as second, driving(one) as third:
        for fmu in (first, second, third):
            fmu.step(0.01)
        assert [fmu["y"] for fmu in (first, second, third)] == pytest.approx([0.1, -0.1, 0.1])


def test_instances_in_threads_wait_for_the_script(tmp_path):
    """Four threads that load a slow script at the same time all get the complete module."""
    out = in_new_process(THREADS, built(tmp_path))
    assert out.split() == ["0.01"] * 4


def test_the_search_path_stays_and_builds_repeat(tmp_path):
    """Loading adds nothing to it; equal files give equal bytes, changed code another GUID."""
    before = list(sys.path)
    with driving(built(tmp_path)):
        assert sys.path == before
    one, two = (build_user(written(tmp_path), tmp_path / n) for n in ("one", "two"))
    other = build_user(written(tmp_path, ("GAIN = 1.0", "GAIN = 1.5")), tmp_path / "three")
    assert one.read_bytes() == two.read_bytes()
    assert read_model_description(str(one)).guid != read_model_description(str(other)).guid
