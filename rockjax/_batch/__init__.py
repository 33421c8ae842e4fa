"""Batches of scenes, on all cores or devices."""
