"""Outputs of a scene: one module each, their registry, and their base class."""
