"""Recordings prepared for identification: reading, usable samples, uniform clocks, derivatives, quality."""
