"""The accepted effects in numbers, places and pictures."""
