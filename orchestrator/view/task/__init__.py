"""The training task: what has to be done, how far it is, and how well it was done."""
