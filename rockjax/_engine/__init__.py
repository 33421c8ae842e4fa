"""The equations, the hybrid automaton (contact modes and events) and the loop that solves one scene, as pure
functions of arrays."""
