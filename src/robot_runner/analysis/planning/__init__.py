"""Planning a study: the number of repetitions, and the design."""
