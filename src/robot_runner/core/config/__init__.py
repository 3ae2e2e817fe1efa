"""The class that a user writes, its loading, and its validation."""
