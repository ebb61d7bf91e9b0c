"""The linear plant, continuous and sampled."""
