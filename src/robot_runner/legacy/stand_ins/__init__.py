"""What the modules of the earlier tools held for config files."""
