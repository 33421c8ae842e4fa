"""Trace every kind of scene with checks of types, shapes and dtypes in every call: `python -m
tests.engine.typed`.

The module runs in a separate process, because the checks must be installed before rockjax is imported.
Nothing is compiled.
"""

import typing

import jax
import jax.numpy as jnp
import numpy as np
from beartype.door import is_bearable
from jaxtyping import TypeCheckError, install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

with install_import_hook("rockjax._engine", "beartype.beartype"):
    import rockjax as rj
    from rockjax._engine import transitions
    from rockjax._engine.coefficients import coefficients
    from rockjax._engine.scene import plan_for, prepare
    from rockjax._engine.solve import _solve
    from rockjax._results import REST

PODIUMS = {
    "block": rj.Podium(0.2, 1.5),
    "rigid": rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)),
    "elastic": rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5)),
}
DEVICES = rj.Tendon(5.0, 60.0), rj.Damper(3.0, 0.5), rj.Inerter(8.0)
BUILDING = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=2)
FURTHER_PODIUMS = {
    "tendon": PODIUMS["rigid"].replace(restrainers=DEVICES[:1]),
    "two modes": PODIUMS["rigid"].replace(superstructure=rj.Modes([24.0, 6.0], [0.5, 0.15])),
    "building with devices": PODIUMS["rigid"].replace(superstructure=BUILDING, restrainers=DEVICES),
}
RECORD = rj.Record(4 * np.sin(0.1 * np.arange(200)), 0.02)
MOTIONS = {
    "pulse": rj.Ricker(4.0, 1.0),
    "wavelet": rj.MavroeidisPapageorgiou(1.0, 1.0),
    "record": RECORD,
    "table": rj.Records.of([RECORD, RECORD]).pick(0),
    "rest": rj.Rest(),
}
PAIR = rj.GroundMotion(MOTIONS["pulse"], rj.Ricker(1.0, 0.5))
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


def check_fields(found, where: str) -> None:
    """Raise `TypeError` for a field whose value does not have the annotated type, such as an undeclared
    None."""
    for name, hint in typing.get_type_hints(type(found)).items():
        value = getattr(found, name)
        if not is_bearable(value, hint):
            raise TypeError(f"{where}: {name} is {value!r}, typed {hint}")
        if hasattr(value, "_fields"):
            check_fields(value, f"{where}.{name}")


def check_scene(name: str, podium, motion) -> None:
    """Check every field of a scene and of its state."""
    options = rj.Options(outputs=(*EVERY, "peak_drift", "peak_floor_acceleration", "margin"))
    plan = plan_for(podium, options, history=False)

    def checked(podium, motion, start):
        for part in prepare(podium, motion, start, None, options, plan):
            check_fields(part, f"{name}, {type(part).__name__}")

    # Passed as arguments, because constants in a trace may be NumPy numbers.
    jax.eval_shape(checked, podium.split_rows(), motion, REST)


def main() -> None:
    for name, podium in (PODIUMS | FURTHER_PODIUMS).items():
        check_scene(name, podium, PAIR)
        check_scene(name, podium, MOTIONS["pulse"])
    for name in ("two modes", "building with devices"):
        for what in ("peaks", "margin", "history"):
            options, history = OPTIONS[what]
            scene = lambda p, m, o=options, h=history: _solve(p, m, REST, None, o, capacity=h)
            jax.eval_shape(scene, FURTHER_PODIUMS[name].split_rows(), PAIR)
            print(what, name, flush=True)
    for what, (options, history) in OPTIONS.items():
        for name, podium in PODIUMS.items():
            for kind, motion in MOTIONS.items():
                of_all = kind == "record" and name != "block"
                if of_all or (what == "peaks" and name == "elastic") or (what, kind) == ("peaks", "pulse"):
                    scene = lambda p, m, o=options, h=history: _solve(p, m, REST, None, o, capacity=h)
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
