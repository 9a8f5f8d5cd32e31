"""Symbols of actions on a scene: loads, drag, natural strains, prescribed motions, velocities."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import Constant
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.coordinate import Held
from fx_beam.scene.inputs import InputSlot
from fx_beam.scene.loads import Load, PlaceTimeFunction, StrainPart, label
from fx_beam.scene.scene import Scene

from .drawing import interpolated, three_digits
from .sheet import Sheet
from .supports import left_of, node_of

# Fractions of the drawing's size: arrows of forces, line loads and motions; radius of rotations.
_FORCE, _LINE_LOAD, _MOTION, _TURN = 0.12, 0.06, 0.08, 0.045
_BESIDE = 0.02
_DRIVEN, _INITIAL, _LOAD, _STRAINED = "#009E73", "#CC79A7", "black", "#D55E00"
_STRAINS = {"axial": r"$\varepsilon^*$", "shear": r"$\gamma^*$", "curvature": r"$\kappa^*$"}
#: Times at which a function of time is evaluated, to find its direction [s].
_TIMES = np.concatenate([[0.0], 2.0 ** np.arange(-12, 8)])
_ARROWS = 12  # largest number of arrows of a line load or of initial velocities


def draw_actions(sheet: Sheet, scene: Scene, si: bool) -> None:
    """Draw all actions, with values in SI units or without units."""
    for load in scene.loads:
        {"force": _force, "moment": _moment, "line load": _line_load}[load.kind](sheet, load, si)
    _drags(sheet, scene)
    _natural_strains(sheet, scene, si)
    _velocities(sheet, scene)
    _prescribed(sheet, scene)
    _motors(sheet, scene)
    if scene.gravity is not None and np.any(scene.gravity):
        _weight(sheet, scene.gravity, si)


def _shown(load: Load) -> np.ndarray:
    """The largest value of a load at the sampled times."""
    if isinstance(load.value, Constant):
        return load.value(0.0)
    if isinstance(load.value, InputSlot):
        return load.value.factor.sum(axis=1)
    return _largest(load)[1]


def _largest(load: Load) -> tuple[float, np.ndarray]:
    """The time at which a load is largest, of those sampled, and its value then."""
    samples = [(0.0, load.value(0.0))]
    for t in _TIMES[1:].tolist():
        try:
            samples.append((t, load.value(t)))
        except Exception:  # noqa: BLE001  # a function may be defined for the times of its run only
            continue
    sizes = [np.hypot(*value) if len(value) == 2 else abs(value[0]) for _, value in samples]
    return samples[int(np.nanargmax(sizes))]


def _words(symbol: str, load: Load, value: float, unit: str, si: bool) -> str:
    if isinstance(load.value, InputSlot):
        return load.value.name + ", follower" * load.follower
    constant = isinstance(load.value, Constant) and load.along is None
    of = "(s, t)" if isinstance(load.value, PlaceTimeFunction) else "(t)"
    of = of if load.along is None else "(s)"
    value_and_unit = f" = {three_digits(value)}{f' {unit}' if si else ''}"
    return symbol + (value_and_unit if constant else of) + ", follower" * load.follower


def _force(sheet: Sheet, load: Load, si: bool) -> None:
    force, tip = _shown(load), _position(load.target)
    size = np.hypot(*force)
    if size > 0:
        tail = tip - _FORCE * sheet.size * force / size
        sheet.arrow([tail, tip], linewidth=1.6, color=_LOAD)
        sheet.label(_words("F", load, size, "N", si), [tail, (tail + tip) / 2], _LOAD)


def _moment(sheet: Sheet, load: Load, si: bool) -> None:
    (moment,) = _shown(load)
    if moment:
        points = _turn(_position(load.target), sheet.size, np.sign(moment))
        sheet.arrow(points, linewidth=1.4, color=_LOAD)
        sheet.label(_words("M", load, moment, "N m", si), points[::4], _LOAD)


def _line_load(sheet: Sheet, load: Load, si: bool) -> None:
    assert isinstance(load.target, Beam)
    beam, factor = load.target, _shown(load)
    arc = np.linspace(0, beam.length, _ARROWS + 1)
    positions = np.array([[node.x, node.y] for node in beam.nodes])
    tips = interpolated(arc, beam.s, positions)
    if isinstance(load.value, PlaceTimeFunction):
        loads = load.value.at(arc, _largest(load)[0])
    elif load.along is None:
        loads = np.tile(factor, (len(arc), 1))
    else:
        loads = factor[0] * np.array([load.along(s) for s in arc])
    sizes = np.hypot(*loads.T)
    if not sizes.max() > 0:
        return
    tails = tips - _LINE_LOAD * sheet.size * loads / sizes.max()
    sheet.line(tails, color=_LOAD, linewidth=0.8)
    seen = sizes > 0.05 * sizes.max()
    for tail, tip in zip(tails[seen], tips[seen], strict=True):
        sheet.arrow([tail, tip], color=_LOAD, linewidth=0.8)
    sheet.label(_words("q", load, sizes.max(), "N/m", si), tails[1:-1], _LOAD)


def _drags(sheet: Sheet, scene: Scene) -> None:
    """The word, at each beam and node with drag."""
    targets = {label(drag.target): drag.target for drag in scene.drags}
    for target in targets.values():
        nodes = target.nodes if isinstance(target, Beam) else (target,)
        sheet.label("drag", [_position(node) for node in nodes[::-1]], _LOAD)


def _natural_strains(sheet: Sheet, scene: Scene, si: bool) -> None:
    """A dashed line beside each beam that has natural strains, with what they are."""
    for strain in scene.natural_strains:
        points = np.array([_position(node) for node in strain.beam.nodes])
        along = np.gradient(points, axis=0)
        left = np.column_stack([-along[:, 1], along[:, 0]])
        left /= np.hypot(*left.T)[:, None]
        beside = points + _BESIDE * sheet.size * left
        sheet.line(beside, color=_STRAINED, linewidth=1.2, linestyle=(0, (4, 2)))
        words = [_of_part(name, part, si) for name, part in strain.parts.items()]
        sheet.label(", ".join(words), beside[len(beside) // 2 :], _STRAINED)


def _of_part(name: str, part: StrainPart, si: bool) -> str:
    """A component of a natural strain: its value, its input, or what it is a function of."""
    symbol, value = _STRAINS[name], part.value
    if isinstance(value, InputSlot):
        return f"{symbol}: {value.name}"
    if part.along is not None:
        return f"{symbol}(f)"
    if isinstance(value, PlaceTimeFunction):
        return f"{symbol}(f, t)"
    if not isinstance(value, Constant):
        return f"{symbol}(t)"
    unit = " 1/m" if si and name == "curvature" else ""
    return f"{symbol} = {three_digits(float(value(0.0)[0]))}{unit}"


def _prescribed(sheet: Sheet, scene: Scene) -> None:
    for number, component in scene.prescribed:
        position = _position(scene.nodes[number])
        if component == 2:
            _double_turn(sheet, position, r"$\psi$(t)")
        else:
            _double_arrow(sheet, position, np.eye(2)[component], "xy"[component] + "(t)")


def _motors(sheet: Sheet, scene: Scene) -> None:
    for joint in scene.joints:
        position = _position(node_of(joint))
        for name in joint.driven:
            locked = isinstance(joint.coordinates[name].motor, Held)
            if name == "slide":
                text = "locked" if locked else "motor d(t)"
                _double_arrow(sheet, position, joint.direction, text)
            else:
                _double_turn(sheet, position, "locked" if locked else r"motor $\psi$(t)")


def _double_arrow(sheet: Sheet, position, direction, text: str) -> None:
    """An arrow with two heads along a direction, beside a point."""
    beside = position + 0.04 * sheet.size * left_of(direction)
    ends = beside + _MOTION * sheet.size * np.outer((-1, 1), direction)
    sheet.arrow([ends[0], beside, ends[1]], "<-|>", color=_DRIVEN, linewidth=1.4)
    sheet.label(text, [ends[1], beside, ends[0]], _DRIVEN)


def _double_turn(sheet: Sheet, position, text: str) -> None:
    points = _turn(position, sheet.size, 1.0)
    sheet.arrow(points, "<-|>", color=_DRIVEN, linewidth=1.4)
    sheet.label(text, points[::4], _DRIVEN)


def _velocities(sheet: Sheet, scene: Scene) -> None:
    """Initial velocities, with arrows in proportion to them."""
    velocities: dict[int, np.ndarray] = {}
    for velocity in scene.velocities:
        nodes = velocity.target.nodes if isinstance(velocity.target, Beam) else (velocity.target,)
        for node in nodes[:: max(1, len(nodes) // _ARROWS)]:
            velocities[node.number] = velocity.value(node.x, node.y)
    largest = max((np.hypot(*value) for value in velocities.values()), default=0.0)
    tips = []
    for number, value in velocities.items():
        if np.hypot(*value) > 0.02 * largest:
            position = _position(scene.nodes[number])
            tips.append(position + _FORCE * sheet.size * value / largest)
            sheet.arrow([position, tips[-1]], color=_INITIAL)
    if tips:
        sheet.label("v(0)", tips, _INITIAL)


def _weight(sheet: Sheet, gravity, si: bool) -> None:
    """The acceleration of gravity, beside everything drawn so far."""
    size = np.hypot(*gravity)
    tip = sheet.corner() + 0.5 * _FORCE * sheet.size * np.asarray(gravity) / size
    tail = tip - _FORCE * sheet.size * np.asarray(gravity) / size
    sheet.arrow([tail, tip], color="0.4")
    sheet.label(f"g = {three_digits(size)}{' m/s$^2$' if si else ''}", [(tail + tip) / 2], "0.4")


def _turn(position, size: float, sense: float) -> np.ndarray:
    """Points (33, 2) of three quarters of a circle about a point."""
    angle = np.pi / 4 + sense * np.linspace(0, 1.5 * np.pi, 33)
    return position + _TURN * size * np.column_stack([np.cos(angle), np.sin(angle)])


def _position(node: Node | Beam) -> np.ndarray:
    assert isinstance(node, Node)
    return np.array([node.x, node.y])
