"""Analytical ground motions, and the base classes of all ground motions."""
