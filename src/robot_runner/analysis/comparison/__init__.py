"""Two experiments compared: real against simulated, measured against estimated, original against replication."""
