"""What goes wrong with a task."""

__all__ = ["TaskError"]


class TaskError(Exception):
    """A task cannot go on. Its text goes into the service's response: what is wrong, and how to mend it."""
