"""Convergence study: the error of each master over the communication step, and what that accuracy costs."""
