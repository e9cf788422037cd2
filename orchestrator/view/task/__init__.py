"""The training task: exercises, progress and score of a run, and the panel that shows them."""
