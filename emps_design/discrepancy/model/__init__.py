"""What is fitted: the parts of a record, a candidate model, its whitened closed-loop residual, least squares."""
