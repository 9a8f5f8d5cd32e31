"""Random planar mechanisms of very different masses and stiffnesses, in any units and directions.

    .venv/bin/python tests/mechanisms.py 0 500 1.0

looks at those of the seeds 0 to 499 and prints which of them are wrong without a warning. The last
number is the width: at 1, stiffnesses are from 1e-3 to 1e12 N, masses per length from 1e-9 to 1e9.
"""

import logging
import sys
from contextlib import contextmanager

import numpy as np

import fx_beam as fb

STEPS = 20
# Largest differences, relative to the largest displacement, and to the size of the scene.
MOST, OF_SIZE = 1e-8, 1e-13


def powers(rng, low, high, width=1.0):
    """A number whose logarithm is uniform, between ends that are times the width."""
    return float(10 ** (width * rng.uniform(low, high)))


def random_parts(rng, width):
    """Beams and bodies as numbers without units; each but the first hangs on one before it."""
    parts, points = [], [(0, "a", np.zeros(2))]
    for number in range(rng.integers(1, 6)):
        parent, end, place = points[rng.integers(len(points))]
        kind = rng.choice(
            ["welded", "revolute", "prismatic", "slot", "free"], p=[0.25, 0.3, 0.15, 0.15, 0.15]
        )
        far = 3 * rng.normal(size=2) if kind == "free" and number else np.zeros(2)
        tip = rng.normal(size=2)
        part = {"parent": (parent, end), "kind": kind, "start": place + far}
        part["end"] = part["start"] + tip / np.hypot(*tip) * powers(rng, -1.5, 0.7)
        if number == 0 or rng.random() < 0.7:
            EA, slender, rhoA = (
                powers(rng, -3, 12, width),
                powers(rng, -8, 0),
                powers(rng, -9, 9, width),
            )
            rhoI = rhoA * slender if rng.random() < 0.8 else 0.0
            part["section"] = EA, EA * powers(rng, -1, 0.3), EA * slender, rhoA, rhoI
            part["elements"] = int(rng.integers(1, 6))
        else:
            part["kind"] = "revolute" if kind == "welded" else kind
            part["mass"], part["inertia"] = (m := powers(rng, -9, 9, width)), m * powers(rng, -4, 1)
        angle = rng.uniform(0, 2 * np.pi)
        part["axis"] = np.array([np.cos(angle), np.sin(angle)])
        part["spring"] = powers(rng, -3, 9, width) if rng.random() < 0.4 else None
        part["damper"] = powers(rng, -6, 3, width) if rng.random() < 0.25 else None
        parts.append(part)
        points.append((number, "b", part["end"]))
    return parts, points


def random_numbers(seed, width=1.0):
    """All that a mechanism is, as numbers without units."""
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 4))
    parts, points = random_parts(rng, width)
    places = [points[i][:2] for i in rng.integers(len(points), size=4)]
    numbers = {"parts": parts, "degree": degree, "held": rng.choice(["pin", "clamp", "free"])}
    numbers["gravity"] = (
        rng.normal(size=2) * powers(rng, -3, 3, width) if rng.random() < 0.6 else None
    )
    numbers["mass"] = (places[0], powers(rng, -9, 9, width)) if rng.random() < 0.5 else None
    numbers["force"] = (
        places[1],
        rng.normal(size=2) * powers(rng, -6, 6, width),
        rng.random() < 0.5,
    )
    numbers["moment"] = (
        (places[2], rng.normal() * powers(rng, -6, 6, width)) if rng.random() < 0.3 else None
    )
    numbers["velocity"] = None
    if rng.random() < 0.4:
        numbers["velocity"] = (
            rng.normal(size=2) * powers(rng, -3, 3, width),
            rng.normal() * powers(rng, -2, 1),
        )
    return numbers


def build(numbers, units=(1.0, 1.0, 1.0), turn=0.0):
    """The scene in units of length, time and mass, turned by an angle [rad]."""
    L, T, M = units
    F, R = M * L / T**2, np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def vector(x, unit=1.0):
        return tuple(float(c) for c in R @ x * unit)

    gravity = numbers["gravity"]
    scene = fb.Scene(gravity=None if gravity is None else vector(gravity, L / T**2))
    nodes, members = {}, []
    for number, part in enumerate(numbers["parts"]):
        parent = nodes[part["parent"]] if number else None
        a, b = vector(part["start"], L), vector(part["end"], L)
        if "section" in part:
            scales = F, F, F * L**2, M / L, M * L
            section = fb.Section(*(x * y for x, y in zip(part["section"], scales, strict=True)))
            start = parent if number and part["kind"] == "welded" else a
            member = scene.add_beam(
                [start, b], section, elements=part["elements"], degree=numbers["degree"]
            )
            nodes[number, "a"], nodes[number, "b"] = member.start, member.end
        else:
            middle = vector((part["start"] + part["end"]) / 2, L)
            inertia = part["inertia"] * M * L**2
            member = scene.add_body(middle, part["mass"] * M, inertia, points={"a": a, "b": b})
            nodes[number, "a"], nodes[number, "b"] = member["a"], member["b"]
        members.append(member)
        if number and part["kind"] in ("revolute", "prismatic", "slot"):
            turns = part["kind"] == "revolute"
            unit, forces = (F * L if turns else F / L), {}
            if part["spring"]:
                forces["spring"] = fb.Spring(part["spring"] * unit)
            if part["damper"]:
                forces["damper"] = fb.Damper(part["damper"] * unit * T)
            kind = {"revolute": fb.Revolute, "prismatic": fb.Prismatic, "slot": fb.PinInSlot}[
                part["kind"]
            ]
            axis = {} if turns else {"axis": vector(part["axis"])}
            scene.add_joint(kind(parent, nodes[number, "a"], **axis, **forces))
    if numbers["held"] != "free":
        getattr(scene, numbers["held"])(nodes[0, "a"])
    if numbers["mass"]:
        scene.add_mass(nodes[numbers["mass"][0]], numbers["mass"][1] * M)
    place, force, follows = numbers["force"]
    scene.add_force(nodes[place], vector(force, F), follower=bool(follows))
    if numbers["moment"]:
        scene.add_moment(nodes[numbers["moment"][0]], float(numbers["moment"][1] * F * L))
    if numbers["velocity"]:
        velocity, spin = numbers["velocity"]
        for member in members:
            scene.set_velocity(member, vector(velocity, L / T), spin=float(spin / T))
        scene.make_velocities_compatible()
    return scene


@contextmanager
def warnings_of_the_package():
    """A list of the warnings in this block."""
    messages, log = [], logging.getLogger("fx_beam")
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    log.addHandler(handler)
    try:
        yield messages
    finally:
        log.removeHandler(handler)


def motion(numbers, units=(1.0, 1.0, 1.0), turn=0.0, split=False):
    """Configurations without units and unturned, and the balance error by the largest energy."""
    L, T, _ = units
    scene = build(numbers, units, turn)
    options = {"dt": T / STEPS, "t_end": T}
    if split:
        half = fb.simulate(scene, dt=T / STEPS, t_end=T / 2)
        solution = half.then(fb.simulate(scene, start=half, **options))
    else:
        solution = fb.simulate(scene, **options)
    c, s = np.cos(turn), np.sin(turn)
    q = solution.q.copy()
    q[..., :2] = q[..., :2] @ np.array([[c, -s], [s, c]]) / L
    energy = solution.energy
    parts = energy.kinetic, energy.stored, energy.potential, energy.work, energy.dissipated
    largest = max(abs(part).max() for part in parts) or 1.0
    return q, abs(energy.balance_error).max() / largest


def differences(seed, width=1.0):
    """Of a mechanism: its differences, relative to what is allowed, and the warnings it gave."""
    numbers, errors = random_numbers(seed, width), {}
    ends = [[part["start"], part["end"]] for part in numbers["parts"]]
    size = max(np.hypot(*np.ptp(ends, axis=(0, 1))), 1e-9)
    with warnings_of_the_package() as messages:
        q, errors["balance"] = motion(numbers)
        allowed = MOST * abs(q).max() + OF_SIZE * size
        variants = {
            "turned": {"turn": 1.0},
            "nm, ns": {"units": (2.0**-30, 2.0**-30, 1.0)},
            "km, years": {"units": (2.0**10, 2.0**25, 2.0**20)},
            "split": {"split": True},
        }
        for name, how in variants.items():
            other, balance = motion(numbers, **how)
            errors[name] = abs(other - q).max() / allowed
            errors["balance"] = max(errors["balance"], balance)
    errors["balance"] /= MOST
    return errors, messages


def main(first, last, width):
    wrong = refused = warned = 0
    for seed in range(first, last):
        try:
            errors, messages = differences(seed, width)
        except (fb.SceneError, fb.StepError):
            refused += 1
            continue
        warned += bool(messages)
        if max(errors.values()) > 1 and not messages:
            wrong += 1
            print(seed, {name: f"{x:.1e}" for name, x in errors.items()})
    print(
        f"{wrong} of {last - first} wrong without a warning; {warned} with one, {refused} refused"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), float(sys.argv[3]))
