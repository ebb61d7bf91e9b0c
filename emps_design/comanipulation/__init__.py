"""A hand guides the carriage under an impedance law: tasks, measures, verdicts."""
