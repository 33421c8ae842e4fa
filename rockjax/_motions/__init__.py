"""Recorded and synthetic ground motions: files, suites, intensity measures."""
