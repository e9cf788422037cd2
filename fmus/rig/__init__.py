"""Virtual test rig: simulated experiments of the paper, recorded with models of the paper's instruments.

    from fmus.rig import experiments, record, write

    for experiment in experiments("detailed"):       # each is simulated once per process
        write(folder, experiment, seed=0)            # adds noise and quantisation to the simulated signals

The command is `harvester rig`.
"""

from fmus.rig.experiments import MACHINES, Experiment, experiments, record
from fmus.rig.recordings import write, write_all

__all__ = ["MACHINES", "Experiment", "experiments", "record", "write", "write_all"]
