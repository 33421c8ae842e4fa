"""Compiled programs, kept between processes: what has been traced and compiled once is only loaded from then
on."""
