"""The numbers of a scene by the indices of a model: the one path on which steps get them."""

from __future__ import annotations

import numpy as np

from fx_beam.coupling.graph import joints_with_arms
from fx_beam.dual import MaybeDual, dual_array
from fx_beam.fem.scene_data import Data, form_data
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import sliding_joints
from fx_beam.scene.structure import OtherStructureError

from .model import Model, damped


def read_numbers(model: Model, scene: Scene) -> Data:
    """The numbers of a scene of the structure of a model; OtherStructureError for other zeros.

    Friction that sticks has the damping of other masses until `Model.set_numbers`.
    """
    X = model.mesh.positions_of(scene)
    data = model.read(scene, X, form_data(scene, model.mesh, X, model.scheme.rates), model.data)
    _check(model, data)
    return data


def data_of(model: Model, scene: Scene) -> Data:
    """The numbers of a scene; OtherStructureError if it differs in more from that of the model."""
    model.structure.check(scene)
    data = read_numbers(model, scene)
    if not model.sticks:
        return data
    fits = not model.couplings.need_places or data.lies_as(model.data)
    fitting = model if fits else Model(scene, model.scheme, part=True)
    return damped(model, data, fitting.reduction)


def _check(model: Model, data: Data) -> None:
    """OtherStructureError if data are of other kinds than the numbers that a model has."""
    known = model.data
    model.forms.check(data.forms)
    if data.masses is not known.masses:
        model.masses.check(data.masses)
    if data.arms.keys() != known.arms.keys():
        raise OtherStructureError("other joints have offsets")
    for old, new in ((known.loads, data.loads), (known.natural, data.natural)):
        if new is not old:
            old.check(new)


def numbers_of(model: Model, data: Data) -> dict[str, MaybeDual]:
    """All numbers by name as flat arrays, with slopes that the scene has."""
    scene, couplings = data.scene, model.couplings
    numbers: dict[str, object] = {"X": data.X, "columns": data.loads.entries}
    numbers |= data.forms.numbers | data.masses
    if data.natural:
        numbers["natural columns"] = data.natural.entries
    if moving := joints_with_arms(couplings, scene):
        axes = [(0.0, 0.0) if joint.axis is None else joint.axis for joint in moving]
        numbers["offset"] = dual_array([joint.offset for joint in moving]).reshape(-1, 2)
        numbers["axis"] = dual_array(axes).reshape(-1, 2)
        numbers["rest"] = [joint.start()[0] for joint in moving]
    if couplings.gears:
        numbers["gears"] = dual_array(data.gears)
    if couplings.sliding:
        joints = {joint.number: joint for joint in sliding_joints(scene.joints)}
        sliding = [joints[joint.number] for joint in couplings.sliding]
        numbers["places"] = [joint.place_at_rest for joint in sliding]
        paths = {id(joint.beam): joint.path for joint in sliding}
        numbers["paths"] = np.concatenate([path.numbers for path in paths.values()])
    return {name: dual_array(values) for name, values in numbers.items()}
