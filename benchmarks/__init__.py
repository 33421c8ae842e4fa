"""Measurements, run by hand: `python -m benchmarks.work_precision`, `.compare`, `.skips`, `.scaling`,
`.startup`, …"""
