"""Places on other machines: the workers of a Dask cluster execute runs."""
