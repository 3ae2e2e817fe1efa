"""What the modules of the earlier tools held for config files, under our own roof."""
