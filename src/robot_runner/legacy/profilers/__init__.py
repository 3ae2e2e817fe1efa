"""The profilers and systems of the earlier tools, with the same methods and files."""
