"""Factors, combinations, exclusions, repetitions, order: the run-table model. Pure: nothing here reads or writes."""
