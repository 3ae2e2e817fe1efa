"""Subjects: the software under test, started and stopped with a run or with the experiment."""
