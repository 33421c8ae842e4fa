"""Compiled programs: their derivatives, and the folder from which later processes load them."""
