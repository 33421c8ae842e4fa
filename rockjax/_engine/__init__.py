"""The equations, the hybrid automaton (contact modes and events) and the loop that solves one scene (one
podium under one excitation), as pure functions of arrays."""
