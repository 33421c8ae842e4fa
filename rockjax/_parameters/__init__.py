"""Parameters of structures and ground motions by name: their tables, their sensitivities, and variants of
structures with other values of parameters."""
