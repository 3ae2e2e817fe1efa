"""Runs, the executors that carry them, the progress manager and the orchestrator."""
