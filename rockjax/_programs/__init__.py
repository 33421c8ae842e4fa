"""Compiled programs, which are stored on disk. Later processes load them, and neither trace nor compile."""
