"""Spectra, fragilities and their sensitivities, computed from many scenes."""
