"""Before a study: how many repetitions it needs."""
