"""Parts of the page around the drawing: toolbar and dialogs, gauges, strip charts, status line, shortcuts."""
