"""Runs, the processes that carry them, the progress manager and the orchestrator."""
