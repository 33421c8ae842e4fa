"""Other implementations of the same model, for comparison."""
