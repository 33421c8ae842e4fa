"""Measurements, run by hand: `python -m benchmarks.work_precision`, `.compare`, `.cost`, `.startup`, …"""
