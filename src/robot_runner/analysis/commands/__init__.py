"""The commands that read results: report, compare, import, export."""
