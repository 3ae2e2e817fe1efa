"""What can be awaited or watched: one vocabulary for readiness, the end of a mission, gates and guards."""
