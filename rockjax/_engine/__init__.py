"""The equations, the automaton and the loop that solves one scene: pure functions of arrays."""
