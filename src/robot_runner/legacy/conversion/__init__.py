"""Convert a config file of an earlier tool to our own spelling; comments and layout are kept."""
