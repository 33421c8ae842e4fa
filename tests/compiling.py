"""What JAX compiles meanwhile."""

import logging

import jax


def compiled_by(call, caplog):
    """What a call compiles as in a new process, but for kept programs: these stay."""
    jax.clear_caches()
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        call()
    return [record.message for record in caplog.records if "Finished XLA compilation" in record.message]
