"""When a result is not reliable, and that each kind of result says so: runs, files, comparisons, batches."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kit.mistakes import table

from orchestrator import Trace, batch, compare, run
from orchestrator.__main__ import main
from orchestrator.engine.job import with_default_guard
from orchestrator.engine.result import (
    BondEnergy,
    Card,
    SignalError,
    bonds_above,
    energies_above,
    metadata,
    read_metadata,
    unreliable_energies,
    unreliable_errors,
)
from orchestrator.ssp.coupling import SHORTER_STEP_GUARD, Suggestion
from orchestrator.ssp.write import write_ssp

ROUGH = {"master": "jacobi", "step": 0.02, "stop": 1.0}  # a delay of 0.02 s feeds the spring with energy


@pytest.fixture(scope="module")
def oscillator(bounce):
    """A mass and a spring, 1 kg, 100 N/m, 100 m/s; force one way, velocity back."""
    return bounce(False)


@pytest.fixture(scope="module")
def rough(oscillator):
    """A result that is not reliable."""
    return run(oscillator, **ROUGH)


# ---- the limits


@pytest.mark.parametrize(("share", "above"), [(0.049, False), (-0.049, False), (0.051, True), (-0.051, True)])
def test_an_energy_error_of_a_twentieth_is_the_limit(share, above):
    """Of what the bond has exchanged, of either sign."""
    bonds = [BondEnergy("good", 0.0, 1.0, 500.0), BondEnergy("it", 200.0 * share, 50.0, 200.0)]
    assert [b.name for b in bonds_above(bonds, 0.05)] == ["it"] * above
    assert len(unreliable_energies(bonds)) == above


@pytest.mark.parametrize("exchanged", [1.01, 0.99, 1.1e-12, 0.9e-12, 4e-33, 0.0])
def test_a_bond_that_hardly_exchanges_energy_does_not_count(exchanged):
    """Less than a hundredth of the largest exchange; alone, below 1e-12 J, as rounding errors at rest."""
    small = BondEnergy("small", 0.5 * exchanged, 1.0, exchanged)
    assert len(unreliable_energies([BondEnergy("large", 0.0, 0.0, 100.0), small])) == (exchanged > 1.0)
    assert len(unreliable_energies([small])) == (exchanged > 1e-12)
    assert unreliable_energies([]) == []


def test_machines_are_judged_one_by_one():
    """Shape (bonds, machines): the largest exchange is that of the same machine."""
    residual = np.array([[0.0, 0.0], [1.0, 1.0]])
    exchanged = np.array([[1e4, 10.0], [10.0, 10.0]])
    assert energies_above(residual, exchanged).tolist() == [[False, False], [False, True]]


@pytest.mark.parametrize(("rms", "told"), [(0.049, False), (0.051, True)])
def test_an_estimated_error_of_a_twentieth_of_the_range_is_the_limit(oscillator, rms, told):
    """Of a signal that feeds a bond; other signals do not count."""
    error = SignalError("spring.force", largest=2 * rms, rms=rms, change=2 * rms * 1000.0)
    assert len(unreliable_errors([error], oscillator)) == told
    assert not unreliable_errors([SignalError("mass.x", 2.0, 1.0, change=2.0)], oscillator)


def test_an_error_is_relative_to_a_thousandth_of_the_nominal_value_at_least():
    """A range of 1 Pa of a pressure of 1e7 Pa does not count: its floor is 1e4 Pa."""
    error = SignalError("p", largest=1.0, rms=0.5, change=1.0)
    assert error.relative_rms(None) == error.relative_rms(1e3) == 0.5
    assert error.relative_rms(1e7) == pytest.approx(0.5 * 1.0 / 1e4, rel=1e-12)  # rounding
    assert SignalError("p", 0.0, 0.0).relative_rms(1.0) == 0.0


# ---- each kind of result


def test_a_run_says_that_it_is_not_reliable(rough, oscillator):
    """In its card, notes, text and metadata; a fine run does not."""
    (reason,) = rough.card.unreliable
    assert reason == rough.card.warnings[0] == rough.notes[0]
    assert not rough.reliable
    assert "not reliable" in repr(rough).splitlines()[0]
    assert f"warning: {reason}" in rough.card.text()
    assert metadata(rough).unreliable == (reason,)
    fine = run(oscillator, **ROUGH | {"step": 1e-4})
    assert fine.reliable
    assert not fine.card.warnings
    assert "not reliable" not in repr(fine)


@table(__file__, "advice", "able, chosen, advice")
def test_the_advice_is_what_helps(oscillator, able, chosen, advice):
    """A guard, where FMUs can go back and none is on; else shorter steps."""
    system = suggesting(oscillator, None, rollback=able)
    (reason,) = run(system, **ROUGH | {"step": 0.02} | chosen).card.unreliable
    assert reason.endswith(f"the result is not reliable, {advice}")


def test_reasons_are_told_once_and_a_further_run_adds_its_own(rough, oscillator):
    """Once also if one is found twice; the further run is that of an estimate by half the step."""
    assert rough.card.doubted(*rough.card.unreliable) == rough.card
    assert Card(master="jacobi", step=1e-3).doubted("a", "b").warnings == ("a", "b")
    result = run(oscillator, **ROUGH, error_estimate=True)
    assert any(reason.startswith("estimated error of the coupling") for reason in result.card.unreliable)


def test_the_command_has_a_status_of_its_own(oscillator, tmp_path, capsys):
    """Status 3, and the metadata next to the trace; `compare` begins with it."""
    ssp = write_ssp(oscillator, tmp_path / "it.ssp")
    out = tmp_path / "rough.csv"
    options = ["--master", "jacobi", "--stop", "1"]
    assert main(["run", str(ssp), "--out", str(out), "--step", "0.02", *options]) == 3
    assert main(["run", str(ssp), "--out", str(tmp_path / "fine.csv"), "--step", "1e-4", *options]) == 0
    stored = read_metadata(out)
    assert stored is not None
    assert len(stored.unreliable) == 1
    assert json.loads(out.with_name("rough.run.json").read_text())["unreliable"] == [*stored.unreliable]
    capsys.readouterr()
    files = [str(out), str(tmp_path / "fine.csv")]
    assert main(["compare", *files, "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.startswith("warning: rough: energy error of the coupling")
    assert "Rough: energy error" in (tmp_path / "comparison.html").read_text()


def test_a_comparison_says_it_below_its_title(rough, oscillator):
    """Of results, too; a trace without metadata says nothing."""
    fine = run(oscillator, **ROUGH | {"step": 1e-4})
    compared = compare({"fine": fine, "rough": rough})
    assert repr(compared).splitlines()[1].startswith("rough: energy error of the coupling")
    bare = Trace(rough.time, rough.trace.signals, rough.units)
    assert not compare({"fine": fine, "bare": bare}).unreliable


def test_machines_one_by_one_have_a_status_of_their_own(oscillator):
    """Not "ok", with the reason; a note says of how many machines."""
    result = batch(oscillator, {"mass.spring": [0.0, 1.0]}, record="mass.x", lanes=False, **ROUGH)
    assert result.status.tolist() == ["unreliable"] * 2
    assert all("not reliable" in reason for reason in result.reasons)
    assert result.notes[0].startswith("2 of 2 machines: energy error of the coupling")
    assert np.isfinite(result["mass.x"]).all()


def test_validate_begins_with_it_and_fails(oscillator, tmp_path, capsys):
    """Status 1 although no signal is outside its limit; the page says it, too."""
    ssp = write_ssp(oscillator, tmp_path / "it.ssp")
    fine = run(ssp, **ROUGH)
    file = fine.write(tmp_path / "truth.csv")
    limit = 'tolerance = { metric = "nrmse", limit = 0.5 }'
    rows = "".join(f'"{name}" = {{ unit = "{unit}", {limit} }}\n' for name, unit in fine.units.items())
    file.with_suffix(".toml").write_text(f'[reference]\ntitle = "itself"\n[signals]\n{rows}')
    chosen = ["--master", "jacobi", "--step", "0.02", "--stop", "1", "--out", str(tmp_path)]
    assert main(["validate", str(ssp), "--reference", str(file), *chosen]) == 1
    printed = capsys.readouterr().out
    assert printed.startswith("FAIL: energy error of the coupling")
    assert "fail, the result is not reliable" in printed
    assert "Energy error of the coupling" in (tmp_path / "report.html").read_text()


# ---- the guard by what FMUs suggest


def suggesting(oscillator, step, rollback=True):
    """The oscillator as a system that suggests 1 ms; its mass suggests another step."""
    able = {"rollback": rollback, "variable_step": True}
    parts = {n: replace(c, interface=replace(c.interface, **able)) for n, c in oscillator.components.items()}
    mass = replace(parts["mass"], interface=replace(parts["mass"].interface, step=step))
    return replace(oscillator, components={**parts, "mass": mass}, suggestion=Suggestion(step=1e-3))


def test_a_step_above_a_suggested_one_is_guarded(oscillator):
    """Of an FMU, with a note, at the step of the system and at that of the user, which may be shorter."""
    system = suggesting(oscillator, 2.5e-4)
    for step, text in ((None, "0.001"), (4e-4, "0.0004"), (1e-2, "0.01"), (1e-4, "0.0001")):
        guarded = with_default_guard(system, step)
        assert guarded.coupling.guard == SHORTER_STEP_GUARD
        expected = f"mass: steps of 0.00025 s are suggested; those of {text} s are divided where"
        assert guarded.notes[-1].startswith(expected)
    found = with_default_guard(suggesting(oscillator, 2.5e-4, rollback=False), None)
    assert found.coupling is None  # an FMU that cannot go back leaves only a note
    assert found.notes[-1] == "mass: steps of 0.00025 s are suggested; this run has steps of 0.001 s"


def test_what_is_chosen_is_not_guarded(oscillator):
    """A guard, adaptive steps; a long step of FMUs that suggest none, or that of the system."""
    system = suggesting(oscillator, 2.5e-4)
    for chosen in ({"guard": 0.0}, {"guard": 1e-3}, {"adaptive": 1e-3}, {"master": "hermite"}):
        coupled = system.coupled(chosen)
        assert with_default_guard(coupled, 1e-3) is coupled
    for step in (None, 1e-3):
        usual = suggesting(oscillator, step)
        assert with_default_guard(usual, 1e-2) is usual
    own = replace(system, suggestion=Suggestion())  # the step of the run is that of the FMU
    assert with_default_guard(own, None) is own
