"""The paper's Turtlebot Basic: a circular mission for benchmarking measurement-based experiments."""
