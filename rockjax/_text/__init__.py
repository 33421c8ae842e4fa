"""Text for users: tables, text files, and representations of objects."""
