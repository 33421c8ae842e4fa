"""Sweeps of many scenes: solved in chunks, saved in a store, resumable, on one machine or a cluster."""
