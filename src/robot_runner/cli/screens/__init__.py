"""What a terminal shows while an experiment is executed: a live screen, or plain lines."""
