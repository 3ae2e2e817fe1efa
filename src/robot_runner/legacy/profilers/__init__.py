"""The profilers and systems that came with the earlier tools, with their calls and their files."""
