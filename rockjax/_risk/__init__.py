"""From ground motions and hazard to the chance of overturning."""
