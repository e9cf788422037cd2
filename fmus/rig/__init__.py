"""A virtual test rig: the paper's experiments on the model, recorded with the paper's instruments."""
