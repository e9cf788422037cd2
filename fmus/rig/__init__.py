"""A virtual test rig: the paper's experiments on the model, recorded with the paper's instruments.

    from fmus.rig import experiments, record, write

    for experiment in experiments("detailed"):       # simulated once, kept in memory
        write(folder, experiment, seed=0)            # noise and converters: nothing is simulated again

The command is `harvester rig`.
"""

from fmus.rig.experiments import MACHINES, Machine, experiments
from fmus.rig.instruments import Experiment, record
from fmus.rig.recordings import write, write_all

__all__ = ["MACHINES", "Experiment", "Machine", "experiments", "record", "write", "write_all"]
