"""Missions of any robot that need no code: systems that a config makes and that say what they measure."""
