"""Config files that were written for the earlier tools, lifted to the one config class."""
