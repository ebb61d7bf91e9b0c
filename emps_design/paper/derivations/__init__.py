"""The paper's equations, derived."""
