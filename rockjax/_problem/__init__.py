"""Problem files (TOML), with a structure, ground motions, options, and a table for each command."""
