"""Descriptive statistics, assumption checks, the test that fits the design, effect sizes, power."""
