"""A notebook and an R script that compute every number of a report again, without Robot Runner."""
