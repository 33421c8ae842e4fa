"""Problem files: a structure, ground motions, options, and a table for each command."""
