"""The screens of a terminal while an experiment is executed: live, or plain lines."""
