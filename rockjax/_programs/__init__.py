"""Compiled programs: their derivatives, and a store on disk, from which later processes load them."""
