"""Names of the analytical pulses in problem files and on the command line; the module does not import JAX."""

# Name of a pulse ↦ name of its class in `pulses.py`.
PULSE_CLASSES = {
    "ricker": "Ricker",
    "antisymmetric-ricker": "AntisymmetricRicker",
    "one-sine": "OneSine",
    "one-cosine": "OneCosine",
    "half-sine": "HalfSine",
}
