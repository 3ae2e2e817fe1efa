"""A notebook and an R script that recompute every number of a report, without Robot Runner."""
