"""Ground motions that are formulas, and what all ground motions have in common."""
