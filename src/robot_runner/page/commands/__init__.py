"""The commands that this room brings."""
