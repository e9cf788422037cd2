"""Report of an identification: HTML page, JSON file and figures; prediction and attribution of residuals."""
