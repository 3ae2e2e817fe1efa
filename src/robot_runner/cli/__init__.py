"""The command line. Only this package and the commands of the rooms print or exit."""
