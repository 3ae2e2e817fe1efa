"""The command that fits a power model."""
