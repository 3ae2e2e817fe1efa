"""Files of an experiment: names, journal, run table, manifest, and writing them so that nothing is lost."""
