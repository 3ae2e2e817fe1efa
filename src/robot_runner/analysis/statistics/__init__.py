"""Descriptive statistics, what is estimated and tested by the design and the plan, effect sizes, power."""
