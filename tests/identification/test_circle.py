"""Identification of a machine that differs from the model: record, identify, predict a held-out cycle."""

from kit import shards

from fmus.identification.pipeline import identify
from fmus.identification.recordings.reading import read_folder
from fmus.identification.report.attribution import attribute
from fmus.identification.report.prediction import default_values, prediction, worst
from fmus.machine.build import harvester_machine
from fmus.parameters import values, write
from fmus.rig import write_all

pytestmark = shards.machine  # the detailed machine at work takes half a minute


def test_the_lumped_machine_predicts_the_detailed_one(tmp_path):
    """It meets the limits on a held-out cycle, and the swinging head explains the residual."""
    write_all(tmp_path / "recordings", "detailed", 0, lambda _: None)
    found = identify(read_folder(tmp_path / "recordings"))
    assert not found.skipped
    assert found.refined is not None
    assert found.refined.converged
    assert not found.refined.at_bound
    seen = prediction(found)
    assert seen is not None
    assert seen.recording.use == "test"
    errors = {kind: error for kind, (_, error) in worst(seen.nrmse()).items()}
    # the bars of the project: NRMSE over the range of the whole recording, worst signal of each kind
    assert errors["angle"] < 0.01
    assert errors["speed"] < 0.05
    assert errors["pressure"] < 0.10
    assert attribute(seen, default_values(found)).effect == "swinging head"
    write(tmp_path / "own.toml", {"parameters": {n: e.number() for n, (e, _) in found.estimates.items()}})
    families = harvester_machine(tmp_path / "own.toml").families.values()
    for sub in (sub for family in families for sub in family.values()):
        own = values(sub).p
        for name, (estimate, _) in found.estimates.items():
            if name in own:
                assert own[name] == estimate.value
