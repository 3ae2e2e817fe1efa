"""Stand-ins for the modules of the earlier tools that config files import."""
