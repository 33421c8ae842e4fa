"""Problem files: a structure, ground motions, options, and what each command does with them."""
