"""Time of the derivatives of a motion, relative to its steps, and size of its tape.

    .venv/bin/python benchmarks/derivatives.py [tries]

Pinned beams of 8, 128 and 2048 elements, a chain of flexible arms with bodies and friction, and
beads that slide on a beam.
Columns: steps with a tape; gradient of a scalar by stiffnesses, masses and the like, not by places
of nodes, that is steps with a tape and the adjoint; the
same if a fifth of the tape's memory is allowed, so that ten parts are repeated; changes of all
states for 1, 5 and 20 numbers. All are processor times relative to the steps without a tape, which
take turns: medians of these ratios.
"""

import sys
from time import process_time

import numpy as np

import fx_beam as fb
from fx_beam.dual import floats
from fx_beam.motions.motion_setup import Options, prepare
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

NUMBERS = 1, 5, 20


def pinned(elements):
    section = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (100, 0)], section, elements=elements)
    scene.pin(beam.start)
    scene.set_velocity(beam, lambda x, y: (0, 12 * min(x, 100 - x)))
    return scene


def arms():
    """Five arms of four elements, with a body at each end and friction in the hinges."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    section = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3)
    for k in range(5):
        arm = scene.add_beam([(k, 0), (k + 1, 0)], section, elements=4)
        body = scene.add_body((k + 1, 0.2), 1.0, 0.05, points={"a": (k + 1, 0)})
        scene.add_joint(fb.Rigid(arm.end, body["a"]))
        if last is None:
            scene.pin(arm.start)
        else:
            scene.add_joint(fb.Revolute(last, arm.start, friction=fb.SmoothFriction(0.1, 0.1)))
        last = arm.end
    return scene


def beads(count):
    """Bodies that slide along a pinned beam of 64 elements."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e5, GA=1e5, EI=500.0, rhoA=1.0, rhoI=1e-3)
    beam = scene.add_beam([(0, 0), (10, 0)], section, elements=64)
    scene.pin(beam.start)
    scene.pin(beam.end)
    for k in range(count):
        body = scene.add_body((0.5 + 8 * k / count, 0), mass=0.5, inertia=0.01)
        scene.add_joint(fb.Slider(beam, body.centre))
        scene.set_velocity(body, (1.0, 0.0))
    return scene


CASES = {
    "8 elements": (lambda: pinned(8), 1e-3, 10000),
    "128 elements": (lambda: pinned(128), 1e-4, 2000),
    "2048 elements": (lambda: pinned(2048), 1e-5, 400),
    "arms with bodies": (arms, 1e-3, 5000),
    "a bead on a beam": (lambda: beads(1), 1e-3, 1600),
    "ten beads": (lambda: beads(10), 1e-3, 400),
}


class Case:
    """A motion that can be repeated."""

    def __init__(self, scene, dt, steps):
        self.prepared = prepare(scene, Options(dt=dt, max_halvings=3))
        self.start = self.prepared.first_state(dt, None)
        self.loop, self.times = self.prepared.loop, dt * np.arange(steps + 1)
        self.tape = Tape(self.loop.problem)

    def run(self, tape=None):
        """Processor time of the steps [s]."""
        record = Record(rates=False, forces=False)
        recorder = Recorder(self.prepared.model, self.times, record)
        self.prepared.loop.record(self.start, recorder)
        self.prepared.stepper.load(self.start)
        self.loop.tape = tape
        if tape is not None:
            tape.clear()
        clock = process_time()
        self.prepared.stepper.advance(self.times[1:], 1, recorder)
        return process_time() - clock


def seconds(function, *arguments):
    """Processor time of a call [s]."""
    clock = process_time()
    function(*arguments)
    return process_time() - clock


def measured(build, dt, steps, tries):
    """Times relative to the steps, and the size of the tape [MB]."""
    case = Case(build(), dt, steps)
    tape, problem, model = case.tape, case.loop.problem, case.prepared.model
    case.run(tape)
    derivatives, ends = TapeDerivatives(problem), tape.times.boundaries(case.times)
    none, names = np.empty(0, dtype=int), derivatives.names - {"X"}

    def weights_of(part):
        rows = ends[part.of_boundaries(ends)]
        return {"q": np.ones((len(rows), model.size))}, rows, none

    values = floats(model.data.forms.beams["stiffness"])
    rng = np.random.default_rng(0)
    changes = [{"stiffness": values * rng.random((count, *values.shape))} for count in NUMBERS]
    size = 8 * len(tape) * tape.c.size
    few = Tape(problem, size / 5)
    rows = []
    for _ in range(tries + 1):
        alone, taped, parted = case.run(), case.run(tape), case.run(few)
        back, back_few = (seconds(derivatives.vjp, own, weights_of, names) for own in (tape, few))
        push = [seconds(derivatives.jvp, tape, change, ends[-1:]) for change in changes]
        rows.append(np.array([taped, taped + back, parted + back_few, *push]) / alone)
    assert not few.is_whole
    return [*np.median(rows[1:], axis=0), 1e-6 * size]  # the first one compiles


def main(tries=9):
    head = ["tape", "gradient", "in parts", *(f"{count} numbers" for count in NUMBERS), "tape [MB]"]
    print(f"{'':18}" + "".join(f"{name:>12}" for name in head))
    for name, case in CASES.items():
        values = measured(*case, tries)
        print(f"{name:18}" + "".join(f"{value:12.3g}" for value in values), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
