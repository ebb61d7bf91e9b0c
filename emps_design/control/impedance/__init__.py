"""The impedance law, (24) to (30): analysis of the loop it makes."""
