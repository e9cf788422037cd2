"""Physics of single hydraulic and mechanical parts, without parameter values, FMI or files.

The few constants here are widths of smooth approximations and the law of cavitation; their comments give
reasons.
"""
