"""The numbers of a scene by the indices of a model: the one path on which steps get them."""

from __future__ import annotations

import functools

import numpy as np

from fx_beam.coupling.graph import joints_with_arms, motors
from fx_beam.coupling.joints_in_c import numbers_of_gears
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.fem.loads import LoadedBeams, dead_loads, natural_strains
from fx_beam.fem.scene_data import Arms, Data, form_data
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import sliding_joints

from .inertia import mobility
from .model import Model, sticks


def data_of(model: Model, scene: Scene) -> Data:
    """The numbers of a scene; OtherStructureError if it differs in more from that of the model."""
    model.structure.check(scene)
    mesh, rates, data = model.mesh, model.scheme.rates, model.data
    X = mesh.positions_of(scene)
    masses, known = model.masses.numbers_of(scene, X), model.data
    loads, natural, forms = known.loads, known.natural, form_data(scene, mesh, X, rates)
    if scene.loads:
        weights = functools.partial(model.masses.places.weights, entries=masses["mass"])
        loads = dead_loads(scene, mesh, floats(X), weights)
    if scene.natural_strains:
        natural = natural_strains(scene, mesh)
    moving = (Arms.of(scene), motors(scene)) if scene.joints else (known.arms, known.motors)
    data = Data(scene, X, forms, masses, loads, natural, *moving, LoadedBeams.of(scene))
    if not rates.at_rest and (scene.joints or scene.contacts) and sticks(scene):
        fits = not model.couplings.need_places or data.lies_as(known)
        fitting = model if fits else Model(scene, model.scheme, part=True)
        mass = model.masses.places.matrix(floats(masses["mass"]))
        moves = mobility(data, mass, fitting.reduction, mesh)
        data = data._replace(forms=form_data(scene, mesh, X, rates, moves))
    _check(model, data)
    return data


def _check(model: Model, data: Data) -> None:
    """OtherStructureError if data are of other kinds than the numbers that a model has."""
    known = model.data
    model.forms.check(data.forms)
    if data.masses is not known.masses:
        model.masses.check(data.masses)
    data.arms.check(known.arms)
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
        numbers["gears"] = dual_array(numbers_of_gears(scene))
    if couplings.sliding:
        joints = {joint.number: joint for joint in sliding_joints(scene.joints)}
        sliding = [joints[joint.number] for joint in couplings.sliding]
        numbers["places"] = [joint.place_at_rest for joint in sliding]
        paths = {id(joint.beam): joint.path for joint in sliding}
        numbers["paths"] = np.concatenate([path.numbers for path in paths.values()])
    return {name: dual_array(values) for name, values in numbers.items()}
