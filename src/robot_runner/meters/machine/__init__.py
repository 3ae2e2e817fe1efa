"""The measured machine: disturbances by other processes, heat and throttling; and its setup for measuring."""
