"""Experiments that a script, a notebook or a test executes: `run_experiment`, without the command line."""
