"""Compiled programs, which are stored on disk. Later processes load them instead of tracing and compiling."""
