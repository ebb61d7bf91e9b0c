"""The velocity loop: gains from a specification, (6) to (9), and what is achieved."""
