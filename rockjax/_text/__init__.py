"""Text that people read and write: tables, headings with units, files of text, cards of objects."""
