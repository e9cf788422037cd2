"""Studies in lanes: results and failures as of single runs, also after an interruption."""

from dataclasses import replace

import numpy as np
import pytest
from kit import shards
from kit.mistakes import problem

from orchestrator.studies import Choice, Factor, Output, Study, store, sweep
from orchestrator.studies.parameter_study import prepare
from orchestrator.studies.runs import StudyRuns

MASS = Factor("manipulator.head_mass", "uniform", {"minimum": 300, "maximum": 900})
OUTPUTS = (
    Output("peak", "swing.swing_pressure_a", "maximum", band=True),
    Output("mean", "boom_stick.boom_force", "mean", start=0.2),
    Output("angle", "manipulator.swing_angle", "final"),
)


@pytest.fixture(scope="module")
def study(fmu_dir):
    """Twenty machines, so that the last group has lanes in excess."""
    return Study("Mass", str(fmu_dir / "harvester.ssp"), runs=20, stop=0.5, factors=(MASS,), outputs=OUTPUTS)


@pytest.fixture(scope="module")
def results(study, tmp_path_factory):
    """The study by two workers."""
    return sweep(study, tmp_path_factory.mktemp("study") / "out", workers=2)


def begun(study):
    """The study, ready to run, and its runs."""
    prepared = prepare(study)
    return prepared, StudyRuns(prepared)


def test_a_study_in_lanes_has_the_results_of_single_runs(study, results):
    """Each output, and the stored signals; the difference is that of the lanes, 1e-11 of the range."""
    prepared, runs = begun(study)
    assert [len(unit) for unit in runs.units(prepared.samples)] == [8, 8, 4]
    assert set(results.table["status"]) == {"ok"}
    for run in (0, 7, 19):
        (single,) = runs.run((prepared.samples[run],))
        row = results.table[results.table["run"] == run].iloc[0]
        found = [row[f"output:{name}"] for name in ("peak", "mean", "angle")]
        np.testing.assert_allclose(found, single.outputs, rtol=1e-9, atol=1e-12)
        band = results.bands[results.bands["run"] == run]["swing.swing_pressure_a"]
        np.testing.assert_allclose(band, single.bands[0], rtol=1e-9)


def test_the_results_do_not_depend_on_the_number_of_workers_or_on_an_interruption(study, results, tmp_path):
    """Bit for bit: two workers, and one after a stop when two runs of a group were stored."""
    prepared, runs = begun(study)
    unit = runs.units(prepared.samples)[1]
    (tmp_path / "stopped").mkdir()
    stored = store.Store(tmp_path / "stopped", prepared)
    stored.add(runs.run(unit)[2:4])
    assert stored.done() == {10, 11}
    assert sweep(study, tmp_path / "stopped", workers=1).table.equals(results.table)


def test_a_run_that_fails_in_lanes_has_the_reason_of_a_single_run(study, tmp_path):
    """The other machines of its group go on."""
    stiffness = Factor("manipulator.stop_stiffness", "values", {"values": [*np.linspace(2e7, 4e7, 7), 1e5]})
    scenario = tmp_path / "down.csv"
    scenario.write_text("time,boom_command\n0,0\n0.1,-10\n2,-10\n")
    grid = Study(
        "Stops", study.system, "grid", stop=2.0, factors=(stiffness,), outputs=OUTPUTS[2:],
        choices=(Choice("scenario", (str(scenario),)),),
    )  # fmt: skip
    results = sweep(grid, tmp_path / "out", workers=1)
    assert list(results.table["status"]) == ["ok"] * 7 + ["failed"]
    prepared, runs = begun(grid)
    (single,) = runs.run((prepared.samples[-1],))
    assert results.table["reason"].iloc[-1] == single.reason


@shards.machine
def test_the_accuracy_of_a_study(study, tmp_path):
    """Coupling and step follow from the accuracy, and the stored signals of all runs have it."""
    study = replace(study, stop=1.0, accuracy=1e-3)
    (case,) = prepare(study).cases.values()
    assert case.system.step > 1e-3
    assert case.options.tolerance == pytest.approx(1.5e-5)
    found, true = (
        sweep(s, tmp_path / s.title, workers=2).bands["swing.swing_pressure_a"].to_numpy()
        for s in (study, replace(study, title="truth", accuracy=None, master="hermite", step=5e-4))
    )
    assert np.sqrt(np.mean(np.square(found - true))) <= 1e-3 * np.ptp(true)


def test_an_accuracy_and_a_step(study, tmp_path):
    """Both together are refused."""
    message = problem(lambda: sweep(replace(study, accuracy=1e-3, step=1e-3), tmp_path / "out"))
    assert message.endswith("accuracy 0.001: expected no step and no master, which follow from it")
