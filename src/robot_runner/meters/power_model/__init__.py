"""Estimates the power of a robot from what it does: its utilisation, its motion and its tasks."""
