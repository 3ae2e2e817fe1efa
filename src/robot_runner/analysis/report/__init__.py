"""The report of an experiment: design, results, and threats to their validity."""
