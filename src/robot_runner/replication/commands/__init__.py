"""The commands about replication packages: pack, verify, replicate, explain."""
