"""The command that converts a config file of an earlier tool."""
