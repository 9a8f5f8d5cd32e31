"""Where the equilibria of random strips end that are squeezed beyond their buckling loads.

    .venv/bin/python benchmarks/lost_stability.py [number of scenes] [first seed]

A strip of steel is heated between two supports, pushed together, pulled together by a tendon,
pressed by a dead force or one that follows its end, or by centrifugal forces, while its weight or a
small force bends it to one side. In all of these a stable path leads to one bow on this side. A
path is "right" if it ends there, "refused" if it ends in an error, "unstable" if its last row is
and a warning says so. The rest is wrong: "silent" if nothing is said, "other" if it is stable and
another bow.
"""

import logging
import sys
from collections import Counter
from time import perf_counter

import numpy as np

import fx_beam as fb

KINDS = "heat", "push", "tendon", "dead", "follower", "spin"
# Units of length, mass and stress, in SI: m, kg, Pa, and mm, t, MPa.
UNITS = {"SI": (1.0, 1.0), "mm": (1e-3, 1e3)}


def random_case(seed):
    """Numbers of a case, in SI."""
    random = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    most = 100.0 if kind in ("heat", "push") else 1.35
    return {
        "kind": kind,
        "clamped": bool(random.integers(2)),
        "length": float(random.choice([0.1, 0.3, 1.0])),
        "height": float(np.exp(random.uniform(np.log(0.2e-3), np.log(5e-3)))),
        "severity": float(np.exp(random.uniform(np.log(0.7), np.log(most)))),
        "is_weight": bool(random.integers(2)),
        "bend": float(10 ** random.uniform(-3, 0)) * float(random.choice([-1, 1])),
        "angle": float(random.choice([0.0, np.radians(37.0)])),
        "units": str(random.choice(list(UNITS))),
        "load_steps": int(np.exp(random.uniform(0, np.log(200)))),
        "continuation": str(random.choice(["load", "arc-length"])),
        "elements": int(random.choice([8, 12])),
    }


def strip(kind, clamped, length, height, severity, is_weight, bend, angle, units, elements):
    """The scene, its beam, the direction in which it bends, and how it turns."""
    metre, kilogram = UNITS[units]
    metre, kilogram = 1 / metre, 1 / kilogram
    E, rho, width = 210e9 * kilogram / metre, 7850.0 * kilogram / metre**3, 10e-3 * metre
    L, h = length * metre, height * metre
    section = fb.Section.rectangle(h, width, E, 0.3, rho)
    critical = section.EI * ((2 if clamped else 1) * np.pi / L) ** 2
    axis = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-axis[1], axis[0]])
    side = float(np.sign(bend)) * across
    weighs = is_weight and kind != "spin"
    scene = fb.Scene(gravity=tuple(9.81 * metre * side) if weighs else (0.0, 0.0))
    start = L * axis if kind == "spin" else 0 * axis
    beam = scene.add_beam([start, start + L * axis], section, elements, degree=2)
    fixed, moved = (beam.end, beam.start) if kind == "spin" else (beam.start, beam.end)
    (scene.clamp if clamped else scene.pin)(fixed)
    if not weighs:
        force = abs(bend) * h * (192 if clamped else 48) * section.EI / L**3
        scene.add_force(beam.node(0.5), tuple(force * side))
    strain = min(severity * critical / section.EA, 0.05)
    if kind == "heat":
        (scene.clamp if clamped else scene.pin)(moved)
        scene.add_natural_strain(beam, axial=strain)
    elif kind == "push":
        if clamped:
            scene.fix(moved, "rotation")
        shift = -min(2 * strain, 0.2) * L * axis
        scene.prescribe(moved, x=shift[0], y=shift[1])
    else:
        guide = fb.Prismatic if clamped else fb.PinInSlot
        scene.add_joint(guide(fb.GROUND, moved, axis=tuple(axis)))
    if kind == "tendon":
        stiffness = severity * critical / (0.5 * L)
        tendon = fb.Spring(stiffness, rest=0.5 * L)
        scene.add_force_between(beam.start, beam.end, spring=tendon)
    elif kind in ("dead", "follower"):
        force = tuple(-severity * critical * axis)
        scene.add_force(moved, force, follower=kind == "follower")
    spin = 0.0
    if kind == "spin":  # about the origin, at a distance L from the near end
        spin = np.sqrt(severity * critical / (section.rhoA * L * 1.5 * L))
    return scene, beam, side, spin


class Told(logging.Handler):
    """Messages that were logged."""

    def __init__(self):
        super().__init__()
        self.text = ""

    def emit(self, record):
        self.text += record.getMessage()


def verdict(load_steps, continuation, **case):
    """How the path of a case ends, the solution or error, and what was said."""
    scene, beam, side, spin = strip(**case)
    how = {"continuation": None if continuation == "load" else continuation, "progress": False}
    told, logger = Told(), logging.getLogger("fx_beam")
    logger.addHandler(told)
    try:
        path = fb.static(scene, load_steps, spin=spin, **how)
    except fb.StepError as error:
        return "refused", error
    finally:
        logger.removeHandler(told)
    if not path.stable[-1]:
        return ("unstable" if "unstable" in told.text else "silent"), path
    if path.stats.failure is not None:
        return "refused", path
    nodes = [beam.node(i / case["elements"]) for i in range(1, case["elements"])]
    w = np.array([path.displacement(node)[-1] @ side for node in nodes])
    return ("right" if w.min() > -1e-6 * abs(w).max() else "other"), path


def main():
    numbers = [int(text) for text in sys.argv[1:3]]
    count, first = (*numbers, *(500, 0)[len(numbers) :])
    logging.getLogger("fx_beam").propagate = False
    counts, times = Counter(), Counter()
    for seed in range(first, first + count):
        case, start = random_case(seed), perf_counter()
        result, outcome = verdict(**case)
        seconds = perf_counter() - start
        name = f"{case['kind']:9}{case['continuation']:11}"
        counts[name + result] += 1
        times[name] += seconds
        if result in ("silent", "other", "unstable") or "-v" in sys.argv:
            print(seed, result, f"{seconds:.1f} s", case, flush=True)
    print(
        f"{'kind':9}{'by':11}{'right':>9}{'refused':>9}{'unstable':>9}{'silent':>9}{'other':>9}{'s':>7}"
    )
    for name in sorted(times):
        results = (
            counts[name + outcome]
            for outcome in ("right", "refused", "unstable", "silent", "other")
        )
        print(name + "".join(f"{outcome:9}" for outcome in results) + f"{times[name]:7.1f}")


if __name__ == "__main__":
    main()
