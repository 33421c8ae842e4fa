"""Simplified methods of practice: hand formulas (P1) to (P7) from papers, guidelines and codes."""
