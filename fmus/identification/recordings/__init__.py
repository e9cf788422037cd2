"""Preparation of recordings for identification: reading, usable samples, uniform clocks, derivatives, quality."""
