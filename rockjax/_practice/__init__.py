"""Simplified methods of practice: hand formulas of papers, guidelines and codes beside the exact answer."""
