"""Text: reading of text files, small tables, and representations of objects."""
