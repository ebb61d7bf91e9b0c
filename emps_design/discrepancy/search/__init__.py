"""Which effects explain the residual: noise, starting points, the search over sets of effects, what is accepted."""
