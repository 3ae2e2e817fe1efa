"""Descriptive statistics, estimates and tests that follow from the design and the plan, effect sizes, power."""
