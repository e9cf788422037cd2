"""Recordings: what was measured, with which instruments, and how far it can be trusted."""
