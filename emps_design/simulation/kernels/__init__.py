"""The compiled steps of a simulation."""
