"""Simplified methods of practice from papers, guidelines and codes, Eqs. (P1) to (P7) of docs/practice.md."""
