"""Writes a config file of an earlier tool in our own spelling; comments and layout stay as they are."""
