"""FMUs of small models, to test the orchestrator with FMUs that this project did not export."""
