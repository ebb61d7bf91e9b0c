"""The force loop around the velocity loop, (10) and (11)."""
