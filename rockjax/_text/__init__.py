"""Text for users: tables, text files, cards of objects."""
