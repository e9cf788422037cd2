"""Analysis of a study: distribution of each output, failed runs, and sensitivities to factors and choices."""
