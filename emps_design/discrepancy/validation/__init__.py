"""What a record that nothing was decided on says."""
