"""What is looked at before an experiment may start: one small function a check."""
