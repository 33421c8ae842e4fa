"""The boundary between survival and overturning, and how all of it is found."""
