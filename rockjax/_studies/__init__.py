"""Spectra, fragilities and their sensitivities: what is made of many scenes."""
