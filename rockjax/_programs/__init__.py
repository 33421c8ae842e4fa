"""Compiled programs, stored between processes: later ones load them and neither trace nor compile."""
