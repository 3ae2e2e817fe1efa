"""The command line: words to calls. The only place that prints or exits."""
