"""Results made elsewhere, adopted as an experiment folder of our own format."""
