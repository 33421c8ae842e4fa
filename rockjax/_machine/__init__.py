"""The machine a program runs on: memory, threads and settings of the environment."""
