"""The small programs that sample on board of a robot: sent over SSH, executed there, gone afterwards."""
