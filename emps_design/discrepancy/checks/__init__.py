"""What must hold before a record is judged."""
