"""The machine on which a process runs: memory, threads and environment variables."""
