"""The parameters of structures and ground motions, and variants of a structure or motion by their names."""
