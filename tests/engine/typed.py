"""Every kind of scene traced with types, shapes and dtypes checked on every call: `python -m
tests.engine.typed`.

In a process of its own: the checks must be there before rockjax is imported. Nothing is compiled.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import TypeCheckError, install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

with install_import_hook("rockjax._engine", "beartype.beartype"):
    import rockjax as rj
    from rockjax._engine import transitions
    from rockjax._engine.coefficients import coefficients
    from rockjax._engine.solve import _solve
    from rockjax._results import REST

PODIUMS = {
    "block": rj.Podium(0.2, 1.5),
    "rigid": rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)),
    "elastic": rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5)),
}
RECORD = rj.Record(4 * np.sin(0.1 * np.arange(200)), 0.02)
MOTIONS = {
    "pulse": rj.Ricker(4.0, 1.0),
    "wavelet": rj.MavroeidisPapageorgiou(1.0, 1.0),
    "record": RECORD,
    "table": rj.Records.of([RECORD, RECORD]).pick(0),
    "rest": rj.Rest(),
}
EVERY = ("peak_rotation", "peak_deformation", "peak_shear", "impacts")
OPTIONS = {
    "peaks": (rj.Options(outputs=EVERY), None),
    "margin": (rj.Options(outputs=(*EVERY, "margin", "errors")), None),
    "history": (rj.Options(), 64),
    "segments": (rj.Options(engine="segments"), None),
    "segments, history": (rj.Options(engine="segments"), 64),
}


def rotation(podium, motion):
    (floats, _), _ = _solve(podium, motion, jax.tree.map(jnp.asarray, REST), None, rj.Options())
    return floats["peak_rotation"]


def main() -> None:
    for what, (options, history) in OPTIONS.items():
        for name, podium in PODIUMS.items():
            for kind, motion in MOTIONS.items():
                of_all = kind == "record" and name != "block"
                if of_all or (what == "peaks" and name == "elastic") or (what, kind) == ("peaks", "pulse"):
                    scene = lambda p, m, o=options, h=history: _solve(p, m, REST, None, o, h)
                    jax.eval_shape(scene, podium, motion)
                    print(what, name, kind, flush=True)
    jax.eval_shape(jax.jacfwd(rotation, argnums=(0, 1)), PODIUMS["elastic"], MOTIONS["pulse"])
    jax.eval_shape(jax.grad(rotation, argnums=(0, 1), allow_int=True), PODIUMS["rigid"], RECORD)
    print("derivatives")
    try:
        transitions.contact_mode(coefficients(PODIUMS["rigid"]), jnp.zeros(3))
    except TypeCheckError:
        print("a vector is no number")


if __name__ == "__main__":
    main()
