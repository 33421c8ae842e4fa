"""Text for users: tables, units, text files, cards of objects."""
