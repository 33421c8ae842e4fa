"""Error against tolerance for ten scenes, and derivatives against finite differences in both modes.

Prints Markdown tables. Errors of the peak rotation are in units of α, against Dopri8 at rtol = 1e-14.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj

G, ALPHA = 9.80665, math.atan(0.15)
FRAME = rj.Podium(0.2, 1.8, gamma=4.0)
BLOCK = rj.Podium(0.3, 2.0)
RIGID = rj.Podium(ALPHA, 1.5, gamma=10.0, superstructure=rj.Rigid(100.0))


def elastic(T_s: float, eta: float = 100.0) -> rj.Podium:
    return rj.Podium(ALPHA, 1.5, gamma=10.0, superstructure=rj.Elastic(eta, T_s))


def ricker(ratio: float, T_p: float = 1.0) -> rj.Ricker:
    return rj.Ricker(ratio * G * 0.15, T_p)


def record() -> rj.Record:
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(400)
    noise = np.convolve(rng.normal(size=400), np.hanning(9), mode="same")
    a = np.exp(-(((t - 2.5) / 1.5) ** 2)) * (np.sin(2 * np.pi * 1.1 * t) + 0.3 * noise / np.abs(noise).max())
    return rj.Record(3.5 * a / np.abs(a).max(), 0.02)


SCENES = {
    "block, one-sine": (BLOCK, rj.OneSine(4.0, 1.2)),
    "block, one-cosine": (BLOCK, rj.OneCosine(3.6, 0.9)),
    "frame, antisymmetric Ricker": (FRAME, rj.AntisymmetricRicker(4.0, 0.9)),
    "frame, half-sine": (FRAME, rj.HalfSine(3.0, 1.0)),
    "rigid, Ricker": (RIGID, ricker(2.5)),
    "rigid, record": (RIGID, record()),
    "T_s = 0.1 s, Ricker": (elastic(0.1), ricker(2.5)),
    "T_s = 0.5 s, Ricker": (elastic(0.5), ricker(2.5)),
    "T_s = 1 s, Ricker": (elastic(1.0), ricker(3.0, 0.9)),
    "T_s = 0.4 s, η = 10, record": (elastic(0.4, 10.0), record()),
}


def peak(scene, rtol: float, method: str) -> float:
    podium, motion = scene
    options = rj.Options(rtol=rtol, atol=max(0.01 * rtol, 1e-16), method=method, outputs=("peak_rotation",))
    return float(rj.peak_response(podium, motion, options=options).peak_rotation)


def tolerances() -> None:
    levels = [10.0**-k for k in range(3, 14)]
    for method in ("tsit5", "dopri8"):
        print(f"\n| {method}, rtol | " + " | ".join(f"{r:.0e}" for r in levels) + " |")
        print("|---|" + "---|" * len(levels))
        for name, scene in SCENES.items():
            best = peak(scene, 1e-14, "dopri8")
            errors = [abs(peak(scene, rtol, method) - best) for rtol in levels]
            print(f"| {name} ({best:.3f} α) | " + " | ".join(f"{e:.0e}" for e in errors) + " |")


def derivatives() -> None:
    print(
        "\nLargest relative error of d(peak rotation) with respect to every number, rtol = 1e-10, and of "
        "reverse − forward"
    )
    print("\n| scene | Tsit5 | Dopri8 | reverse − forward |\n|---|---|---|---|")
    for name, (podium, motion) in SCENES.items():
        if isinstance(motion, rj.Record):
            continue
        leaves, structure = jax.tree.flatten((podium, motion))
        y = jnp.stack(leaves)

        def f(y, rtol, method, structure=structure):
            podium, motion = jax.tree.unflatten(structure, list(y))
            options = rj.Options(rtol=rtol, atol=0.01 * rtol, method=method, outputs=("peak_rotation",))
            return rj.peak_response(podium, motion, options=options).peak_rotation

        numeric = []
        for i in range(len(leaves)):
            h = 1e-4 * float(y[i])
            if h == 0:  # a number at the edge of its range
                numeric.append(np.nan)
                continue
            at = lambda k, i=i, h=h, f=f, y=y: float(f(y.at[i].add(k * h), 1e-13, "dopri8"))
            numeric.append((8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h))
        numeric = np.array(numeric)
        known = np.abs(numeric) * np.abs(np.asarray(y)) > 1e-4
        row = []
        for method in ("tsit5", "dopri8"):
            forward = np.asarray(jax.jacfwd(lambda y, m=method: f(y, 1e-10, m))(y))
            reverse = np.asarray(jax.grad(lambda y, m=method: f(y, 1e-10, m))(y))
            row.append(np.max(np.abs(forward / numeric - 1)[known]))
        row.append(np.max(np.abs(reverse - forward)))
        print(f"| {name} | " + " | ".join(f"{e:.0e}" for e in row) + " |", flush=True)


if __name__ == "__main__":
    tolerances()
    derivatives()
