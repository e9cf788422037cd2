"""Masters of other projects against ours, on the same FMUs, in one process, in turns: `make bench-peers`.

`settings.py` is the list of what is run; `tools/` has one file for each tool.
"""
