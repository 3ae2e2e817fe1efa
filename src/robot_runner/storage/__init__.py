"""Bytes to disk safely, the names of files and folders, the journal, the run-table file and the manifest."""
