"""The machine a program runs on: its memory, its threads, settings of its environment."""
