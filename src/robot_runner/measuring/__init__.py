"""What profilers share: samples, their integrals, their quality; serial lines and the computers that are sampled."""
