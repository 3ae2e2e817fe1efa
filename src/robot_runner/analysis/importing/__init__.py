"""Import results of other tools, or made by hand, as an experiment folder."""
