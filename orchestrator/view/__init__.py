"""The operator's view in a browser."""
