"""Many runs: a study of parameters, scenarios and variants, on all cores or a cluster."""
