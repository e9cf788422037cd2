"""What the runs of a study say: summary of each output, failed runs, which factors move what."""
