"""Many scenes at once, on all cores or devices."""
