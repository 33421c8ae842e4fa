"""Outputs of a scene: one module each, a registry, and the protocol that they share."""
