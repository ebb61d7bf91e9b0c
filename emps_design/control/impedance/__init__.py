"""Analysis of the loop of the impedance law, (24) to (30)."""
