"""Simplified methods of practice: hand formulas from papers, guidelines and codes."""
