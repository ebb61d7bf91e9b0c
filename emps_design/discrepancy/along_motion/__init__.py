"""Diagnosis of records whose loop cannot be simulated: forces balanced along the motion as it was measured."""
