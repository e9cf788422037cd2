"""Benches: one part of the machine between a supply, a throttle and the instruments."""
