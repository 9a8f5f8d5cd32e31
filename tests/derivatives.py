"""Runs on a tape, and the numbers of their scenes, for tests of derivatives."""

import numpy as np

import fx_beam as fb
from fx_beam.analyses.run_setup import RunSetup
from fx_beam.compiled.adjoint import Adjoint
from fx_beam.compiled.forward import Forward
from fx_beam.compiled.tape import Tape
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.stepping.recorder import Record, Recorder
from fx_beam.stepping.substeps import Halving


class Run:
    """A motion, on a tape if it is asked for."""

    def __init__(self, scene, scheme, dt, steps, taped=False, disturb=None):
        self.setup = setup = RunSetup(scene, scheme, None, Halving(3, dt), "compiled")
        self.model, self.loop = setup.model, setup.stepper.integrator
        self.start = state = setup.first_state(dt, None)
        if disturb is not None:
            disturb(state)
        self.times = dt * np.arange(steps + 1)
        recorder = Recorder(self.model, self.times, Record())
        recorder.record(0, state)
        if taped:
            self.loop.tape = Tape(self.loop.problem)
        self.end = setup.stepper.march(state, self.times[1:], 1, recorder)
        #: Histories (steps + 1, ...).
        self.rows = {name: recorder.arrays[name][: steps + 1] for name in ("q", "v", "slides")}
        if len(self.model.scheme.fractions) == 1:  # else forces are means over sub-steps
            forces = {"constraints": "constraint_forces", "joints": "joint_forces"}
            forces = {name: recorder.arrays[row][1 : steps + 1] for name, row in forces.items()}
            self.rows |= {name: rows for name, rows in forces.items() if rows.size}

    @property
    def sub_steps(self):
        """Sub-steps whose forces are among the rows."""
        return np.arange(len(self.loop.tape) * ({"constraints", "joints"} & {*self.rows} != set()))

    def adjoint(self, weights, steps=None):
        """Derivatives of the sum of weights times states after some steps, by default all."""
        at = self.loop.tape.boundaries(self.times if steps is None else self.times[steps])
        forces = self.sub_steps if {"constraints", "joints"} & {*weights} else self.sub_steps[:0]
        return Adjoint(self.loop.problem).pull(self.loop.tape, weights, at, forces)


def numbers(run, starts, lengths):
    """The numbers of a scene by the names of `Adjoint.pull`, for sub-steps of a tape."""
    model, state = run.model, run.start
    joints, forcing, ends = model.reduction.joint_tables(), run.setup.forcing, starts + lengths
    found = {"mass": model.mass.data, "points": model.points.numbers, "X": model.mesh.X}
    found |= {"q": state.q, "v": state.v, "slides": state.slides}
    found |= {"columns": model.loads.columns.data, "loads": forcing.loads(starts, ends)}
    found |= {"driven": forcing.series(ends)}
    if len(parameters := model.forms.parameters):
        found["parameters"] = parameters.over_steps(starts, ends, model.scheme.rates.level)
    if (members := model.points.members) is not None:
        found |= {"members": members.numbers, "arcs": members.arcs}
    if model.weight is not None:
        found["weight"] = model.weight
    if len(model.points.followers):
        found["thrust"] = model.points.followers.series(starts, ends)
    if isinstance(model.reduction, JointReduction):
        found |= {"offset": joints["offset"], "axis": joints["axis"]}
        found["rest"] = np.array([joint.start()[0] for joint in model.couplings.moving])
    if sliding := model.sliding:
        found["places"] = np.array([joint.place_at_rest for joint in sliding])
        found["paths"] = np.concatenate([joint.path.numbers for joint in sliding])
    if (beams := model.forms.beams) is not None:
        fields = {name.replace("times", "retardation"): f for name, f in beams.of_sections.items()}
        if beams.drag is not None:
            fields |= {f"drag {name}": field for name, field in beams.of_drag.items()}
        cells = len(model.mesh.beam_of_cell)
        found |= {name: field.data.by_cells(cells).values for name, field in fields.items()}
    return {name: np.array(value) for name, value in found.items()}


def both(build, scheme=None, dt=0.01, steps=20, h=1e-5):
    """Derivative of a random function of a motion by the number 1 of `build`, in two ways.

    By the adjoint with differences of the scene's numbers, and by differences of the motion.
    Returns both, and the size of the parts of the first.
    """
    scheme = scheme or fb.EnergyMomentum()
    run = Run(build(1.0), scheme, dt, steps, taped=True)
    weights = _weights(run)
    found, tape = run.adjoint(weights), run.loop.tape
    low, high = (Run(build(x), scheme, dt, steps) for x in (1 - h, 1 + h))
    ends = [numbers(part, tape.starts, tape.lengths) for part in (low, high)]
    changes = {name: (ends[1][name] - ends[0][name]) / (2 * h) for name in ends[0]}
    # The positions of points of rigid bodies count in their offsets alone.
    parts = [(found.get(name, np.zeros(1)) * change).sum() for name, change in changes.items()]
    values = [
        sum((weights[name] * part.rows[name]).sum() for name in weights) for part in (low, high)
    ]
    return sum(parts), (values[1] - values[0]) / (2 * h), max(map(abs, parts))


def _weights(run):
    """Random weights of the rows of a run; forces, with larger round-off, have smaller ones."""
    rng, weights = np.random.default_rng(0), {}
    for name, rows in run.rows.items():
        largest = abs(rows).max(initial=1.0) if name in ("constraints", "joints") else 1.0
        weights[name] = rng.standard_normal(rows.shape) / largest
    if "constraints" in weights:  # forces of nodes on beams are among those of the joints
        couplings = run.model.couplings
        weights["constraints"][:, couplings.independent - couplings.free :] = 0.0
    return weights


def forward_and_backward(build, scheme=None, dt=0.01, steps=20):
    """Derivatives of a random function of a motion in nine random directions of all its numbers.

    By changes of the states, of which C follows four directions at once, and by the adjoint;
    arrays (9,). Driven motions change in the first half of the steps alone, and not in the
    directions of the second group.
    """
    rng = np.random.default_rng(0)
    run = Run(build(1.0), scheme or fb.EnergyMomentum(), dt, steps, taped=True)
    tape = run.loop.tape
    at, adjoint = tape.boundaries(run.times), Adjoint(run.loop.problem)
    changes = {
        name: rng.standard_normal((9, *values.shape)) * abs(values).max(initial=0.0)
        for name, values in numbers(run, tape.starts, tape.lengths).items()
    }
    changes["driven"][4:8] = changes["driven"][:, len(tape) // 2 :] = 0.0
    states = Forward(adjoint).push(tape, changes, at, run.sub_steps)
    weights = _weights(run)
    found = adjoint.pull(tape, weights, at, run.sub_steps)
    forward = [
        sum((weights[name].ravel() * states[name][:, j].ravel()).sum() for name in weights)
        for j in range(9)
    ]
    backward = [
        sum((found[name] * change[j]).sum() for name, change in changes.items() if name in found)
        for j in range(9)
    ]
    return np.array(forward), np.array(backward)
