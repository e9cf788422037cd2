"""Numbers beside the machine: gauges, strip charts, the line of the state, the bar of buttons."""
