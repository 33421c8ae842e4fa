"""Probability and annual frequency of overturning, from ground motions and hazard."""
