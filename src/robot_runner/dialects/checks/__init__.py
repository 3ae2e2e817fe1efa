"""What is looked at in a config file of an earlier tool: one small function a check."""
