"""The machine around the meter: what else goes on where something is measured, and how a machine is set up for it."""
