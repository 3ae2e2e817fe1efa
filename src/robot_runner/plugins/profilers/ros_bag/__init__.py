"""The profiler that records topics into a bag."""
