"""Estimates the power of a robot from its utilisation, its motion and its tasks."""
