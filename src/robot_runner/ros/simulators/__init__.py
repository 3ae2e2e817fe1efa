"""Simulators on a graph: reset between runs, paused in between, and how fast their time goes."""
