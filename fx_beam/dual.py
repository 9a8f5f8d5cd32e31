"""Numbers with slopes: values, and derivatives by the numbers x from which a scene is built."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.mixins import NDArrayOperatorsMixin

# Types of lists, and of numbers without slopes.
_SEQUENCES, _NUMBERS = frozenset([list, tuple]), frozenset([float, int, bool, np.float64])
# Attributes of an array that are those of the values.
_SHAPES = frozenset(["shape", "ndim", "size", "dtype"])
# Step in the imaginary direction, for slopes without cancellation.
_STEP = 1e-100


class LostSlopesError(TypeError):
    """Something takes plain floats alone; slopes by the `numbers` would be lost in it."""

    def __init__(self, name: str, arguments: Iterable):
        super().__init__(f"{name} takes no number that has slopes; a function of NumPy may")
        lists = (part if type(part) is list else [part] for part in arguments)
        duals = [dual for dual in itertools.chain(*lists) if isinstance(dual, Dual)]
        changes = [dual.slopes.reshape(-1, dual.count).any(axis=0) for dual in duals]
        #: Indices of the numbers by which arguments have slopes.
        self.numbers = {*np.flatnonzero(np.any(changes, axis=0)).tolist()} if duals else set()


class Dual(NDArrayOperatorsMixin):
    """Values (...) with slopes (..., m) by m numbers; NumPy's functions and arithmetic keep both.

    It is no float: what can keep no slopes, such as ``math.sin``, raises `LostSlopesError`.
    Comparisons compare the values.
    """

    __slots__ = "slopes", "values"

    def __init__(self, values: npt.ArrayLike, slopes: np.ndarray):
        self.values, self.slopes = np.asarray(values, float), slopes

    @property
    def count(self) -> int:
        """Number m of the numbers by which there are slopes."""
        return self.slopes.shape[-1]

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers (k,) by which slopes differ from zero, and their slopes (..., k)."""
        numbers = np.flatnonzero(self.slopes.reshape(-1, self.count).any(axis=0))
        return numbers, self.slopes[..., numbers]

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Derivatives (m,) from a gradient (n,) by the values (n,)."""
        return gradient @ self.slopes

    def __getattr__(self, name: str) -> Any:
        if name in _SHAPES:
            return getattr(self.values, name)
        if name in _METHODS:  # NumPy calls those of functions for the entries of arrays of objects
            return functools.partial(_METHODS[name], self)
        if name == "T":
            return np.transpose(self)
        raise AttributeError(name)

    def __len__(self):
        return len(self.values)

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    def __getitem__(self, key):
        values = self.values[key]
        if isinstance(key, tuple) and any(part is Ellipsis for part in key):
            key = (*key, slice(None))
        return Dual(values, self.slopes[key])

    def reshape(self, *shape) -> Dual:
        """Values and slopes in another shape."""
        values = self.values.reshape(*shape)
        return Dual(values, self.slopes.reshape(*values.shape, self.slopes.shape[-1]))

    def tolist(self) -> list:
        """Nested lists of entries."""
        return [part.tolist() if part.ndim else part for part in self]

    # -- What plain numbers have ------------------------------------------------------------------

    def plain(self, name: str) -> np.ndarray:
        """The values, if there is no slope; LostSlopesError otherwise."""
        if self.slopes.any():
            raise LostSlopesError(name, [self])
        return self.values

    def __float__(self):
        return float(self.plain("float(), or a function of math,"))

    def __int__(self):
        return int(self.plain("int()"))

    __index__ = __int__

    def __array__(self, dtype=None, copy=None):
        if dtype is not None and np.dtype(dtype).kind != "O":
            return self.plain("an array of floats").astype(dtype)
        entries = np.empty(self.shape, object)
        for index in np.ndindex(self.shape):
            entries[index] = self[index]
        return entries

    def __bool__(self):
        return bool(self.values)

    def __format__(self, spec):
        return format(self.values.item() if not self.ndim else self.values, spec)

    # -- Functions of NumPy -----------------------------------------------------------------------

    def __mul__(self, other):
        if type(other) is float:  # as most factors are
            return Dual(self.values * other, self.slopes * other)
        return np.multiply(self, other)

    __rmul__ = __mul__

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        if ufunc is np.add and method == "reduce":
            return _sum(*inputs, **{"axis": 0} | options)
        if method != "__call__" or options:
            name = f"numpy.{ufunc.__name__}.{method}"
            return _call_without_slopes(name, getattr(ufunc, method), inputs, options)
        parts = [_parts(part) for part in inputs]
        if None in parts:
            return _call_without_slopes(type(inputs[parts.index(None)]).__name__, ufunc, inputs, {})
        arguments = [values for values, _ in parts]
        if (rules := _RULES.get(ufunc)) is None:
            if ufunc is np.matmul:
                return _matmul(*parts)
            if ufunc in _WITHOUT_SLOPES:
                return ufunc(*arguments)
            return _call_without_slopes(f"numpy.{ufunc.__name__}", ufunc, inputs, {})
        values = ufunc(*arguments)
        changes = list[np.ndarray]()
        for (_, slopes), rule in zip(parts, rules, strict=True):
            if slopes is not None:
                factor = rule(values, *arguments)
                changes.append(slopes if factor is _ONE else np.asarray(factor)[..., None] * slopes)
        total = changes[0] if len(changes) == 1 else changes[0] + changes[1]
        shape = *values.shape, self.slopes.shape[-1]
        return Dual(values, total if total.shape == shape else np.broadcast_to(total, shape))

    def __array_function__(self, function, kinds, inputs, options):
        if function in _PLACING:
            return _placed(function, inputs, options)
        if function in _FUNCTIONS:
            return _FUNCTIONS[function](*inputs, **options)
        if function in _WITHOUT_SLOPES:
            return function(*map(floats, inputs), **options)
        return _call_without_slopes(f"numpy.{function.__name__}", function, inputs, options)


#: An array, or a `Dual` if numbers in it have slopes.
MaybeDual = np.ndarray | Dual


class LinearDual(Dual):
    """A linear function of numbers with slopes; its own slopes are computed when they are read."""

    def __init__(
        self,
        function: Callable[[MaybeDual], MaybeDual],
        dual: Dual,
        transposed: Callable[[np.ndarray], np.ndarray],
    ):
        self.values, self._dual = floats(function(dual.values)), dual
        self._function, self._transposed = function, transposed

    @property
    def count(self) -> int:
        """Number m of the numbers by which there are slopes."""
        return self._dual.count

    @functools.cached_property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (k,) by which slopes differ from zero, and their slopes; no others are made."""
        numbers, slopes = self._dual.columns
        columns = self._function(Dual(self._dual.values, slopes))
        return numbers, with_slopes(columns, len(numbers)).slopes

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Derivatives (m,) from a gradient (n,) by the values, without the slopes."""
        return self._dual.along(self._transposed(gradient))

    @property
    def slopes(self) -> np.ndarray:  # type: ignore[override]
        """Slopes (n, m), made anew."""
        (numbers, columns), slopes = self.columns, np.zeros((*self.shape, self.count))
        slopes[..., numbers] = columns
        return slopes


def linear(
    function: Callable[[MaybeDual], MaybeDual],
    values: MaybeDual,
    transposed: Callable[[np.ndarray], np.ndarray],
) -> MaybeDual:
    """A linear function of values, as a `LinearDual` if they have slopes."""
    if isinstance(values, Dual):
        return LinearDual(function, values, transposed)
    return function(values)


class LinearChanges:
    """Changes (m, ...) of a `LinearDual`: an array that is computed when it is read."""

    def __init__(self, dual: LinearDual):
        self._dual = dual

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Products (m,) with a gradient, without the array."""
        return self._dual.along(gradient)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (m, ...) of the array."""
        return self._dual.count, *self._dual.shape

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (k,) whose changes may differ from zero, and the changes (k, n)."""
        numbers, columns = self._dual.columns
        return numbers, columns.T

    def __array__(self, dtype=None, copy=None):
        return _by_x(self._dual.slopes)

    def __getitem__(self, key):
        return self.__array__()[key]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__array__(), name)


def changes_of(values: MaybeDual, count: int) -> Any:
    """d values / dx (m, ...) of values (...) by the m numbers x; zero without slopes."""
    if isinstance(values, LinearDual):
        return LinearChanges(values)
    if isinstance(values, Dual):
        return _by_x(values.slopes)
    # Zeros that take no memory, and cannot be written to.
    return np.ndarray((count, *values.shape), buffer=bytes(8), strides=(0,) * (1 + values.ndim))


def nonzero_rows(changes: np.ndarray | LinearChanges) -> np.ndarray:
    """Indices (k,) of the rows of changes (m, ...) that may differ from zero."""
    if isinstance(changes, LinearChanges):
        return changes.columns[0]
    return np.flatnonzero(changes.reshape(len(changes), -1).any(axis=1))


def _by_x(slopes: np.ndarray) -> np.ndarray:
    return slopes.transpose(slopes.ndim - 1, *range(slopes.ndim - 1))


class DualFloat(float):
    """A float in a scene, with slopes (m,); arithmetic with other floats keeps them."""

    slopes: np.ndarray

    def __new__(cls, value: float, slopes: np.ndarray):
        """A float with slopes."""
        number = super().__new__(cls, value)
        number.slopes = slopes
        return number

    def __reduce__(self):
        return float, (float(self),)

    def __neg__(self):
        return DualFloat(-float(self), -self.slopes)


class DualArray(np.ndarray):
    """Values in a scene, with `slopes` (..., m) beside; results of functions of it have none."""

    slopes: np.ndarray | None = None

    def __array_finalize__(self, other):
        self.slopes = None

    def __getitem__(self, key):
        values, slopes = super().__getitem__(key), self.slopes
        return values if slopes is None else scene_number(Dual(values, slopes[key]))

    def __iter__(self):
        return (self[i] for i in range(len(self)))


def slopes_by(x: np.ndarray, constant: Iterable[int] = ()) -> Dual:
    """Numbers x (m,) with the slopes dx/dx = 1; those of the numbers `constant` are 0."""
    slopes = np.eye(len(x))
    for i in constant:
        slopes[i, i] = 0.0
    return Dual(x, slopes)


def scene_number(dual: MaybeDual | float) -> Any:
    """A dual number or array as a scene keeps it: a `DualFloat` or `DualArray`; others as is."""
    if not isinstance(dual, Dual):
        return dual
    if not dual.ndim:
        return DualFloat(float(dual.values), dual.slopes)
    array = np.array(dual.values).view(DualArray)
    array.slopes = dual.slopes
    return array


def dual_of(value: object) -> Dual | None:
    """Numbers of any shape as a dual number; None if nothing in them has slopes."""
    if isinstance(value, Dual):
        return value
    if isinstance(value, DualFloat | DualArray):
        return None if value.slopes is None else Dual(value, value.slopes)
    if isinstance(value, np.ndarray) and value.dtype == object:
        return dual_of(value.tolist())
    if not isinstance(value, list | tuple) or _flat(value) is not None:
        return None
    duals = {i: dual for i, part in enumerate(value) if (dual := dual_of(part)) is not None}
    if not duals:
        return None
    slopes = np.zeros((len(value), *next(iter(duals.values())).slopes.shape))
    for i, dual in duals.items():
        slopes[i] = dual.slopes
    return Dual([duals[i].values if i in duals else part for i, part in enumerate(value)], slopes)


def _flat(values: Sequence) -> tuple[Sequence, list[int]] | None:
    """Numbers of nested lists and their shape; None if one is no float, or lengths differ."""
    shape = [len(values)]
    while not (kinds := {*map(type, values)}) <= _NUMBERS:
        if not kinds <= _SEQUENCES or len(lengths := {*map(len, values)}) > 1:
            return None
        values = [*itertools.chain.from_iterable(values)]
        shape += lengths
    return values, shape


def dual_array(values: object) -> MaybeDual:
    """An array of floats, or a `Dual` if any entry has slopes."""
    if type(values) is np.ndarray and values.dtype == float:
        return np.array(values)  # quickly
    if isinstance(values, list | tuple) and (flat := _flat(values)) is not None:
        return np.array(flat[0], float).reshape(flat[1])  # quickly
    dual = dual_of(values)
    return np.array(values, float) if dual is None else dual


def floats(values: MaybeDual) -> np.ndarray:
    """The values without slopes."""
    return values.values if isinstance(values, Dual) else values


def _call_without_slopes(name: str, function: Callable, inputs: Sequence, options: dict) -> Any:
    """Result of a function of plain numbers; LostSlopesError if an argument has slopes."""
    if (error := LostSlopesError(name, inputs)).numbers:
        raise error
    plain = ([*map(floats, x)] if type(x) is list else floats(x) for x in inputs)
    return function(*plain, **options)


def with_slopes(values: object, count: int) -> Dual:
    """Values with slopes by `count` numbers, zero where they have none."""
    dual = dual_array(values)
    return dual if isinstance(dual, Dual) else Dual(dual, np.zeros((*dual.shape, count)))


def _parts(value: Any) -> Any:
    """Values and slopes, which may be None, of an argument; None if it is no number."""
    if type(value) is Dual:
        return value.values, value.slopes
    if type(value) in (float, int) or (type(value) is np.ndarray and value.dtype == float):
        return value, None
    if (dual := dual_of(value)) is not None:
        return dual.values, dual.slopes
    with suppress(Exception):  # of what is no number
        # UFL does not end if it is asked for the number of a symbol.
        if not (hasattr(value, "ufl_shape") or np.iscomplexobj(value)):
            return np.asarray(value, float), None
    return None


def _in_scene(function: Callable) -> Callable:
    def result(self, other):
        if not isinstance(other, float | int | np.ndarray):
            return NotImplemented
        return scene_number(function(Dual(self, self.slopes), other))

    return result


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _text in (f"__{_name}__", f"__r{_name}__"):
        setattr(DualFloat, _text, _in_scene(getattr(Dual, _text)))


def _slope(function: Callable) -> Callable:
    """The derivative of an analytic function of one argument."""
    return lambda o, a: function(a + _STEP * 1j).imag / _STEP


#: Derivative of a sum by a part: slopes need no product with it.
_ONE = 1.0
#: Derivatives of functions by each argument, of the result and the arguments.
_RULES: dict[np.ufunc, tuple[Callable, ...]] = {
    np.add: (lambda o, a, b: _ONE, lambda o, a, b: _ONE),
    np.subtract: (lambda o, a, b: _ONE, lambda o, a, b: -1.0),
    np.multiply: (lambda o, a, b: b, lambda o, a, b: a),
    np.true_divide: (lambda o, a, b: 1 / b, lambda o, a, b: -o / b),
    np.power: (
        lambda o, a, b: np.where(b == 0, 0.0, b * a ** np.where(b == 0, 1.0, b - 1)),
        lambda o, a, b: o * np.log(np.where(a > 0, a, 1.0)),
    ),
    np.remainder: (lambda o, a, b: 1.0, lambda o, a, b: -np.floor(a / b)),
    np.arctan2: (lambda o, a, b: b / (a * a + b * b), lambda o, a, b: -a / (a * a + b * b)),
    np.hypot: (lambda o, a, b: a / np.where(o, o, 1.0), lambda o, a, b: b / np.where(o, o, 1.0)),
    np.maximum: (lambda o, a, b: a >= b, lambda o, a, b: a < b),
    np.minimum: (lambda o, a, b: a <= b, lambda o, a, b: a > b),
    np.negative: (lambda o, a: -1.0,),
    np.positive: (lambda o, a: 1.0,),
    np.absolute: (lambda o, a: np.sign(a),),
    np.deg2rad: (lambda o, a: np.pi / 180,),
    np.rad2deg: (lambda o, a: 180 / np.pi,),
    np.sin: (lambda o, a: np.cos(a),),
    np.cos: (lambda o, a: -np.sin(a),),
}
_ANALYTIC = (
    *(np.sqrt, np.square, np.reciprocal, np.exp, np.exp2, np.expm1, np.log, np.log2, np.log10),
    *(np.log1p, np.tan, np.arcsin, np.arccos, np.arctan, np.sinh, np.cosh, np.tanh, np.arcsinh),
)
_RULES |= {function: (_slope(function),) for function in _ANALYTIC}
#: Functions that have no slopes.
_WITHOUT_SLOPES = {
    *(np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
    *(np.isfinite, np.isnan, np.isinf, np.floor, np.ceil, np.sign, np.floor_divide),
    *(np.shape, np.ndim, np.size, np.zeros_like, np.ones_like, np.empty_like, np.full_like),
    *(np.any, np.all, np.array_equal, np.searchsorted, np.argsort, np.argmax, np.argmin),
    np.iscomplexobj,
}


def _matmul(a: tuple, b: tuple) -> Dual:
    (A, dA), (B, dB) = a, b
    total = np.zeros(())
    if dA is not None:
        change = B.T @ dA if B.ndim < 3 else np.moveaxis(np.moveaxis(dA, -1, 0) @ B, 0, -1)
        total = total + change
    if dB is not None:
        change = A @ dB if B.ndim == 1 else np.moveaxis(A @ np.moveaxis(dB, -1, 0), 0, -1)
        total = total + change
    return Dual(A @ B, total)


def _along(function: Callable) -> Callable:
    """A linear function of the values along an axis, or of all."""

    def result(a, axis=None, **options) -> Dual:
        a, axis = (a, axis % a.ndim) if axis is not None else (a.reshape(-1), 0)
        return Dual(*(function(array, axis=axis, **options) for array in (a.values, a.slopes)))

    return result


_sum = _along(np.sum)


def _interp(x, xp, fp) -> MaybeDual:
    """Linear interpolation; at a point with the slopes of the piece behind it."""
    x, xp, fp = map(dual_array, (x, xp, fp))
    places, points = floats(x), floats(xp)
    if len(points) == 1:
        return fp[np.zeros(np.shape(places), int)]
    i = points[1:-1].searchsorted(places, "right")
    w = _clip((x - xp[i]) / (xp[i + 1] - xp[i]), 0.0, 1.0)
    if isinstance(w, Dual) or not isinstance(fp, Dual):
        return fp[i] + w * (fp[1:] - fp[:-1])[i]
    low_slopes, slopes = fp.slopes.take(i, 0), fp.slopes.take(i + 1, 0)
    slopes -= low_slopes  # in place, as there may be many
    slopes *= w[..., None]
    slopes += low_slopes
    return Dual(np.interp(places, points, fp.values), slopes)


def _clip(a, low=None, high=None) -> MaybeDual:
    a = a if low is None else np.maximum(a, low)
    return a if high is None else np.minimum(a, high)


def _linspace(start, stop, num=50, endpoint=True):
    fractions = np.linspace(0.0, 1.0, num, endpoint)
    start, stop = dual_array(start), dual_array(stop)
    return start + fractions.reshape(-1, *[1] * np.ndim(start)) * (stop - start)


def _broadcast_to(a, shape) -> Dual:
    if a.values.shape == shape:
        return a
    values = np.broadcast_to(a.values, shape)
    return Dual(values, np.broadcast_to(a.slopes, (*values.shape, a.slopes.shape[-1])))


def _bincount(index, weights, size):
    count = weights.slopes.shape[-1]
    places = (index[:, None] * count + np.arange(count)).ravel()
    slopes = np.bincount(places, weights.slopes.ravel(), size * count).reshape(size, count)
    return Dual(np.bincount(index, weights.values, size), slopes)


def _joined(function: Callable, arrays: Sequence, axis: int = 0) -> Dual:
    """Arrays side by side, without numbers of their entries, as there may be many."""
    count = next(dual.slopes.shape[-1] for dual in map(dual_of, arrays) if dual is not None)
    duals = [with_slopes(array, count) for array in arrays]
    values = function([dual.values for dual in duals], axis)
    return Dual(values, function([dual.slopes for dual in duals], axis % values.ndim))


def _norm(a: Dual, ord: object = None, axis: int | None = None) -> MaybeDual:  # noqa: A002  # as NumPy's
    if ord is not None:
        return _call_without_slopes(f"numpy.linalg.norm of order {ord}", np.linalg.norm, (a,), {})
    return np.sqrt(_sum(a * a, axis))


_FUNCTIONS: dict[Callable, Callable] = {
    np.sum: _sum,
    np.mean: _along(np.mean),
    np.cumsum: _along(np.cumsum),
    np.diff: lambda a, n=1, axis=-1: _along(functools.partial(np.diff, n=n))(a, axis),
    np.dot: lambda a, b: np.matmul(a, b) if np.ndim(a) and np.ndim(b) else a * b,
    np.outer: lambda a, b: dual_array(a).reshape(-1)[:, None] * dual_array(b).reshape(-1),
    np.interp: _interp,
    np.clip: _clip,
    np.max: lambda a: a.reshape(-1)[int(a.values.argmax())],
    np.min: lambda a: a.reshape(-1)[int(a.values.argmin())],
    np.linalg.norm: _norm,
    np.linspace: _linspace,
    np.bincount: _bincount,
    np.concatenate: functools.partial(_joined, np.concatenate),
    np.stack: functools.partial(_joined, np.stack),
    np.broadcast_to: _broadcast_to,
}
#: Functions that only place entries, and numbers of the arguments with the entries.
_PLACING = dict.fromkeys(
    (np.hstack, np.vstack, np.column_stack, np.dstack, np.reshape)
    + (np.ravel, np.transpose, np.atleast_1d, np.atleast_2d, np.copy, np.repeat, np.tile, np.flip)
    + (np.roll, np.squeeze, np.expand_dims, np.swapaxes, np.moveaxis, np.take, np.diag),
    (0,),
) | {np.where: (1, 2), np.append: (0, 1)}


def _placed(function: Callable, inputs: Sequence, options: dict) -> Dual:
    """The result of a function that only places entries: of values, then of rows of slopes."""
    parts, count = list[np.ndarray](), 1

    def values_and_rows(value: npt.ArrayLike) -> tuple[object, object]:
        nonlocal count
        if isinstance(value, list | tuple):
            pairs = [values_and_rows(part) for part in value]
            return [values for values, _ in pairs], [rows for _, rows in pairs]
        if (dual := dual_of(value)) is None:
            return value, np.zeros(np.shape(value), int)  # row 0 has no slopes
        parts.append(dual.slopes.reshape(-1, dual.slopes.shape[-1]))
        first, count = count, count + len(parts[-1])
        return dual.values, np.arange(first, count).reshape(dual.shape)

    placed = _PLACING[function]
    pairs = [values_and_rows(x) if i in placed else (floats(x),) * 2 for i, x in enumerate(inputs)]
    values, rows = (function(*arguments, **options) for arguments in zip(*pairs, strict=True))
    slopes = np.concatenate([np.zeros((1, parts[0].shape[1])), *parts])
    return Dual(values, slopes.take(rows, 0))


_AS_METHODS: tuple[Callable, ...] = (
    *(rule for rule in _RULES if rule.nin == 1),
    *(np.sum, np.mean, np.cumsum, np.dot, np.clip, np.repeat),
    *(np.ravel, np.transpose, np.copy, np.squeeze, np.argsort),
)
_METHODS = {function.__name__: function for function in _AS_METHODS}
_METHODS |= {"max": np.max, "min": np.min, "flatten": np.ravel}
