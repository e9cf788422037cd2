"""The command line: defaults, one-line errors with exit status 2, records of interrupted runs."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from kit.fmu import in_new_process
from kit.mistakes import refused, table
from kit.needs import needs
from zoo.command import command

from fmus.export.compile import PLATFORMS
from fmus.parameters import SOURCES
from fmus.rig.recordings import MACHINES
from orchestrator import Trace, read_trace, write_ssp, write_trace
from orchestrator.__main__ import main
from orchestrator.check.report import TOOLS
from orchestrator.cli import app
from orchestrator.cli.lists import KINDS
from orchestrator.ssp.masters import MASTERS

SSD = Path(__file__).with_suffix(".ssd").read_text(encoding="utf-8")


def harvester(arguments):
    """The exit status of a command."""
    return main(arguments.split())


@pytest.fixture
def folder(tmp_path, monkeypatch, fmus, zip_ssp):
    """A working directory with build/harvester.ssp and a scenario."""
    monkeypatch.chdir(tmp_path)
    write_trace(Trace(np.array([0.0, 1.0]), {"command": np.array([0.0, 4.0])}), "cycle.csv")
    (tmp_path / "build").mkdir()
    zip_ssp(SSD, {"resources/gain.fmu": fmus["gain"]}, "build/harvester.ssp")
    return tmp_path


@pytest.mark.usefixtures("folder")
def test_system_and_output_have_defaults(capsys):
    """The built system, and a trace beside it."""
    assert harvester("run --scenario cycle.csv --step 0.25") == 0
    np.testing.assert_array_equal(read_trace("build/trace.csv")["g.y"], [0, 1, 2, 3, 4])
    printed = capsys.readouterr().out
    assert "4 steps" in printed
    assert "build/trace.csv: 2 signals, 5 rows" in printed


@pytest.mark.usefixtures("folder")
def test_all_options_reach_the_run(capsys):
    """Master, times, start values, output format, error estimate."""
    write_trace(Trace(np.array([0.0, 9.0]), {"command": np.array([0.0, 9.0])}), "other.csv")
    options = "--master gauss-seidel --step 0.5 --start 1 --stop 3 --set g.factor=3 --set g.offset=1"
    files = "--scenario other.csv --out new/out.parquet"
    assert harvester(f"run build/harvester.ssp {files} {options} --error-estimate") == 0
    trace = read_trace("new/out.parquet")
    assert (trace.time[0], trace.time[-1], trace["g.y"][0]) == (1.0, 3.0, 4.0)
    assert "change of the signals when the step is halved; at order p the error is" in capsys.readouterr().out


@pytest.mark.usefixtures("folder")
@table(__file__, "steps", "times, step")
def test_records_at_200_hz_unless_told(times, step, capsys):
    """The default interval is 5 ms or just below, at least a step; the steps of the card stay all steps."""
    assert harvester(f"run --stop 0.012 --step {step}") == 0
    # point n is start + n * step: rounding only
    np.testing.assert_allclose(read_trace("build/trace.csv").time, times, rtol=0, atol=1e-15)
    assert f"{round(0.012 / float(step.split()[0]))} steps" in capsys.readouterr().out


@pytest.fixture
def pair(tmp_path, monkeypatch, oscillator):
    """A working directory with pair.ssp, two coupled masses."""
    monkeypatch.chdir(tmp_path)
    return write_ssp(oscillator, tmp_path / "pair.ssp")


def noted(file="o.run.json"):
    """What stands beside a trace."""
    return json.loads(Path(file).read_text(encoding="utf-8"))


@pytest.mark.usefixtures("pair")
@table(__file__, "choices", "coupling, options")
def test_every_choice_of_the_coupling_reaches_the_run(coupling, options):
    """They are noted beside the trace, all of them and no others."""
    assert harvester(f"run pair.ssp --stop 0.1 --step 0.01 --out o.csv {options}") == 0
    found = noted()
    assert found["coupling"] == {"master": "gauss-seidel", "order": 0} | coupling
    assert found["steps"] >= 10
    assert found["passes"] >= found["steps"]


@pytest.mark.usefixtures("pair")
def test_an_adaptive_run_records_where_it_was(capsys):
    """Every communication point; with a record step exactly its points."""
    run = "run pair.ssp --adaptive 0.01 --stop 0.1 --out o.csv"
    assert harvester(run) == 0
    free, facts = read_trace("o.csv").time, noted()
    assert len(free) == facts["steps"] + 1
    assert facts["lengths"] == pytest.approx([np.diff(free).min(), np.diff(free).max()], rel=1e-6)  # 9 digits
    assert "every" not in capsys.readouterr().out.splitlines()[-1]
    assert harvester(f"{run} --record-step 0.02") == 0
    np.testing.assert_array_equal(read_trace("o.csv").time, [0.0, 0.02, 0.04, 0.06, 0.08, 0.1])
    assert "6 rows, every 0.02 s" in capsys.readouterr().out


@pytest.mark.usefixtures("pair")
def test_an_adaptive_run_is_validated_every_5_ms():
    """The report tells its tolerance and the range of its steps."""
    Path("m.csv").write_text("time,a.x\n0,0\n0.1,1\n", encoding="utf-8")
    Path("m.toml").write_text('[signals."a.x"]\nunit = "m"\n', encoding="utf-8")
    options = "--reference m.csv --master hermite --adaptive 0.01 --stop 0.1 --out ."
    assert harvester(f"validate pair.ssp {options}") in (0, 1)
    # 9 digits in the file
    np.testing.assert_allclose(read_trace("run.csv").time, np.arange(21) * 0.005, rtol=0, atol=1e-9)
    card, coupling = noted("report.json")["accuracy"], noted("run.run.json")
    assert card["lengths"] == coupling["lengths"]
    assert (card["adaptive"], card["record_step"]) == (0.01, 0.005)


@pytest.mark.usefixtures("pair")
def test_runs_that_are_compared_are_told_apart(capsys):
    """Master and step of each, of adaptive runs the mean."""
    for name, options in (("a", "--step 0.01"), ("b", "--adaptive 0.01 --master hermite")):
        assert harvester(f"run pair.ssp --stop 0.1 --out {name}.csv {options}") == 0
    capsys.readouterr()
    assert harvester("compare a.csv b.csv --out .") == 0
    told = capsys.readouterr().out
    mean = noted("b.run.json")["step"]
    assert re.search(r"^a +gauss-seidel +0.01 s ", told, re.MULTILINE)
    assert re.search(rf"^b +hermite +{mean:.3g} s mean ", told, re.MULTILINE)
    assert noted("comparison.json")["runs"]["b"]["coupling"]["adaptive"] == 0.01


@pytest.mark.usefixtures("folder")
@table(__file__, "mistakes", "arguments, message")
def test_mistakes_are_one_line_and_status_2(capsys, arguments, message):
    """No traceback."""
    assert message in refused(capsys, arguments.split())


@needs("POSIX", "sends a POSIX signal")
def test_ctrl_c_leaves_the_record(fmus, tmp_path):
    """A signal in the middle of a run: exit status 130, the record readable and whole."""
    arguments = ["run", fmus["mass_b"], "--stop", "1e4", "--record-step", "1e-3", "--out", "o.parquet"]
    partial = tmp_path / "o.partial.csv"
    # 100 kB are more than 1000 rows of at most 80 characters
    ended = command(arguments, tmp_path, lambda: partial.is_file() and partial.stat().st_size > 100_000)
    assert (ended.status, ended.left) == (130, ())
    assert "Traceback" not in ended.err
    assert "is in o.partial.csv" in ended.out
    assert len(read_trace(partial).time) > 1000


@pytest.mark.parametrize(
    ("command", "option", "values"),
    [
        ("run", "--master", MASTERS),
        ("convergence", "--masters", MASTERS),
        ("check", "--for", (*TOOLS, "any")),
        ("build", "--platform", ("host", "all", *PLATFORMS)),
        ("parameters", "--source", SOURCES),
        ("signals", "--kind", KINDS),
        ("rig", "--machine", MACHINES),
    ],
)
def test_help_names_the_values_to_type(command, option, values):
    """The text of an option with a fixed list of values names each of them."""
    parameters = typer.main.get_command(app).commands[command].params
    text = next(p.help for p in parameters if option in p.opts)
    assert [value for value in values if value not in text] == []


def test_help_starts_fast():
    """Heavy packages are not imported to show the help."""
    code = "import sys; from orchestrator.__main__ import main; main(['--help']); print(sorted(sys.modules))"
    loaded = in_new_process(code)
    for heavy in ("'numpy'", "'fmpy'", "'scipy'", "'casadi'", "'pyarrow'", "'matplotlib'"):
        assert heavy not in loaded


def test_a_run_imports_few_modules(fmu_dir, tmp_path):
    """`harvester run` needs at most 52 modules of the project, packages not counted."""
    arguments = ["run", str(fmu_dir / "swing.fmu"), "--stop", "0.01", "--out", str(tmp_path / "run.csv")]
    code = f"import sys; from orchestrator.__main__ import main; main({arguments}); "
    code += "print(*(n for n, m in sys.modules.items() if not hasattr(m, '__path__')))"
    own = [n for n in in_new_process(code).splitlines()[-1].split() if n.startswith("orchestrator.")]
    assert "orchestrator.engine.run" in own
    assert len(own) <= 52, own
