"""Record which programs JAX compiles."""

import logging

import jax


def compiled_by(call, caplog):
    """Return the names of the programs that a call compiles, as in a new process; stored programs stay
    available."""
    jax.clear_caches()
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        call()
    return [record.message for record in caplog.records if "Finished XLA compilation" in record.message]
