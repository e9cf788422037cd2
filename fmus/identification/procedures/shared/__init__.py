"""What several procedures use: what is given, regression, means of steps."""
