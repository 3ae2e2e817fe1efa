"""Help for profilers: the measured window, integration over real time stamps, and the quality of samples."""
