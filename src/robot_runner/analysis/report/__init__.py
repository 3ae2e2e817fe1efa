"""The report of an experiment: what was done, what came of it, and how far it can be trusted, in one file."""
