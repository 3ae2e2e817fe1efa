"""The live page: an experiment as it is executed, in a browser, followed from its folder alone."""
