"""The equations, the automaton and the loop that solves one scene, as pure functions of arrays."""
