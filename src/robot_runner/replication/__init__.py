"""An experiment folder sealed as a replication package, checked, executed again, and explained."""
