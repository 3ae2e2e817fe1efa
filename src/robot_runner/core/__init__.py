"""The core: what every experiment needs, from its design to the run table on disk. It imports no room beside it."""
