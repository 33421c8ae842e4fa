"""What a user would pick instead: other implementations of the same model, to measure against."""
