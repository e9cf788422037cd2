"""The machine in a browser: drawing, gauges, charts, and control by sticks."""
