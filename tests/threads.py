"""Threads that work on after what is tested has its answer."""

import threading


def wait_for(name):
    """For threads of a name: others may wait for work as long as the process lives."""
    for thread in threading.enumerate():
        if thread.name == name:
            thread.join(60)
            assert not thread.is_alive()
