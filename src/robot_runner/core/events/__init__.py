"""The events of an experiment, the contexts that callbacks get, measures, and the event manager."""
