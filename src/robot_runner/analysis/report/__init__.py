"""The report of an experiment: what was done, what was found, and how far it can be trusted."""
