"""Parameters of structures and ground motions, and variants of a structure or motion by parameter names."""
