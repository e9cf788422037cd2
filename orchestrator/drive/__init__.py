"""The machine in space, and the machine on a page: what `view`, reports and the documentation draw."""
