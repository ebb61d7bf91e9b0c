"""Sampled loops and their margins."""
