"""The boundary between survival and overturning, and the search for it."""
