"""Numbers with slopes: values, and their derivatives by the numbers of which a scene is built."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

# Types of lists, and of numbers without slopes.
_SEQUENCES, _NUMBERS = frozenset([list, tuple]), frozenset([float, int, bool, np.float64])
# Step in the imaginary direction, for slopes without cancellation.
_STEP = 1e-100


class LostSlopesError(TypeError):
    """Something takes plain floats alone; slopes by the `numbers` would be lost in it."""

    def __init__(self, what: str, given: Iterable):
        super().__init__(f"{what} takes no number that has slopes; a function of NumPy may")
        one_by_one = (one for part in given for one in (part if type(part) is list else [part]))
        slopes = [one.slopes for one in one_by_one if isinstance(one, Dual)]
        by = [rows.reshape(-1, rows.shape[-1]).any(axis=0) for rows in slopes]
        self.numbers = {*np.flatnonzero(np.any(by, axis=0)).tolist()} if by else set()


class Dual(NDArrayOperatorsMixin):
    """Values (...) with slopes (..., m) by m numbers; NumPy's functions and arithmetic keep both.

    It is no float: what can keep no slopes, such as ``math.sin``, raises `LostSlopesError`.
    Comparisons are those of the values.
    """

    __slots__ = "slopes", "values"

    def __init__(self, values: Any, slopes: np.ndarray):
        self.values, self.slopes = np.asarray(values, float), slopes

    shape = property(lambda self: self.values.shape)
    ndim = property(lambda self: self.values.ndim)
    size = property(lambda self: self.values.size)
    dtype = property(lambda self: self.values.dtype)
    count = property(lambda self: self.slopes.shape[-1])

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers (k,) by which slopes differ from zero, and these slopes (..., k)."""
        by = np.flatnonzero(self.slopes.reshape(-1, self.count).any(axis=0))
        return by, self.slopes[..., by]

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Derivatives (m,) from a gradient (n,) by the values (n,)."""
        return gradient @ self.slopes

    def __getattr__(self, name: str) -> Any:
        if name in _METHODS:  # NumPy calls those of functions for the entries of arrays of objects
            return functools.partial(_METHODS[name], self)
        raise AttributeError(name)

    @property
    def T(self) -> Any:  # noqa: N802  # as of arrays
        """Transposed."""
        return np.transpose(self)

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
        """The same of another shape."""
        values = self.values.reshape(*shape)
        return Dual(values, self.slopes.reshape(*values.shape, self.slopes.shape[-1]))

    def tolist(self) -> list:
        """Nested lists of entries."""
        return [part.tolist() if part.ndim else part for part in self]

    # -- What plain numbers have ------------------------------------------------------------------

    def plain(self, what: str) -> np.ndarray:
        """The values, if there is no slope; LostSlopesError otherwise."""
        if self.slopes.any():
            raise LostSlopesError(what, [self])
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

    def __array_ufunc__(self, ufunc, method, *given, **options):
        if ufunc is np.add and method == "reduce":
            return _sum(*given, **{"axis": 0} | options)
        if method != "__call__" or options:
            what = f"numpy.{ufunc.__name__}.{method}"
            return _call_without_slopes(what, getattr(ufunc, method), given, options)
        parts = [_parts(part) for part in given]
        if None in parts:
            return _call_without_slopes(type(given[parts.index(None)]).__name__, ufunc, given, {})
        arguments = [values for values, _ in parts]
        if (rules := _RULES.get(ufunc)) is None:
            if ufunc is np.matmul:
                return _matmul(*parts)
            if ufunc in _OF_VALUES:
                return ufunc(*arguments)
            return _call_without_slopes(f"numpy.{ufunc.__name__}", ufunc, given, {})
        values = ufunc(*arguments)
        total: Any = None
        for (_, slopes), rule in zip(parts, rules, strict=True):
            if slopes is not None:
                factor = rule(values, *arguments)
                by = slopes if factor is _ONE else np.asarray(factor)[..., None] * slopes
                total = by if total is None else total + by
        shape = *values.shape, self.slopes.shape[-1]
        return Dual(values, total if total.shape == shape else np.broadcast_to(total, shape))

    def __array_function__(self, function, kinds, given, options):
        if function in _PLACING:
            return _placed(function, given, options)
        if function in _FUNCTIONS:
            return _FUNCTIONS[function](*given, **options)
        if function in _OF_VALUES:
            return function(*map(without_slopes, given), **options)
        return _call_without_slopes(f"numpy.{function.__name__}", function, given, options)


class LinearDual(Dual):
    """A linear function of numbers with slopes; its own slopes are computed when they are read."""

    def __init__(
        self, values: np.ndarray, function: Callable[[Dual], Dual], of: Dual, transposed: Callable
    ):
        self.values, self._function, self._of, self._transposed = values, function, of, transposed

    count = property(lambda self: self._of.count)

    @functools.cached_property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """As of `Dual`, of which no others are computed."""
        by, slopes = self._of.columns
        return by, self._function(Dual(self._of.values, slopes)).slopes

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """As of `Dual`, without the slopes."""
        return self._of.along(self._transposed(gradient))

    @functools.cached_property
    def slopes(self) -> np.ndarray:  # type: ignore[override]
        """The slopes (n, m)."""
        (by, columns), slopes = self.columns, np.zeros((*self.shape, self.count))
        slopes[..., by] = columns
        return slopes


class LinearChanges:
    """Changes (m, ...) of a `LinearDual`: an array that is computed when it is read."""

    def __init__(self, dual: LinearDual):
        self._dual = dual

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """Products (m,) with a gradient, without the array."""
        return self._dual.along(gradient)

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array."""
        return self._dual.count, *self._dual.shape

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (k,) by which they may differ from zero, and changes (k, n) by these."""
        by, columns = self._dual.columns
        return by, columns.T

    def __array__(self, dtype=None, copy=None):
        return _by_x(self._dual.slopes)

    def __getitem__(self, key):
        return self.__array__()[key]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__array__(), name)


def changes_of(values: Any, count: int) -> Any:
    """Changes (m, ...) of numbers by those that they have slopes by."""
    if isinstance(values, LinearDual):
        return LinearChanges(values)
    if isinstance(values, Dual):
        return _by_x(values.slopes)
    # Zeros that take no memory, and cannot be written to.
    return np.ndarray((count, *values.shape), buffer=bytes(8), strides=(0,) * (1 + values.ndim))


def nonzero_rows(changes: Any) -> np.ndarray:
    """The parameters (k,) by which changes (m, ...) of numbers may differ from zero."""
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

    slopes: Any = None

    def __array_finalize__(self, other):
        self.slopes = None

    def __getitem__(self, key):
        values, slopes = super().__getitem__(key), self.slopes
        return values if slopes is None else scene_number(Dual(values, slopes[key]))

    def __iter__(self):
        return (self[i] for i in range(len(self)))


def slopes_by(x: np.ndarray, without: Iterable[int] = ()) -> Dual:
    """Numbers x (m,) with the slopes dx/dx = 1; those `without` have the slope 0."""
    slopes = np.eye(len(x))
    for i in without:
        slopes[i, i] = 0.0
    return Dual(x, slopes)


def scene_number(dual: Any) -> Any:
    """What a scene keeps of a dual number, or of several; other numbers are as they were."""
    if not isinstance(dual, Dual):
        return dual
    if not dual.ndim:
        return DualFloat(float(dual.values), dual.slopes)
    array: Any = np.array(dual.values).view(DualArray)
    array.slopes = dual.slopes
    return array


def dual_of(value: Any) -> Dual | None:
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


def _flat(values: Any) -> tuple[Any, list[int]] | None:
    """Numbers of nested lists and their shape; None if one is no float, or lengths differ."""
    shape = [len(values)]
    while not (kinds := {*map(type, values)}) <= _NUMBERS:
        if not kinds <= _SEQUENCES or len(lengths := {*map(len, values)}) > 1:
            return None
        values = [*itertools.chain.from_iterable(values)]
        shape += lengths
    return values, shape


def as_dual_array(values: Any) -> Any:
    """An array of numbers, with slopes if any of them has."""
    if isinstance(values, list | tuple) and (flat := _flat(values)) is not None:
        return np.array(flat[0], float).reshape(flat[1])  # quickly
    dual = dual_of(values)
    return np.array(values, float) if dual is None else dual


def without_slopes(values: Any) -> Any:
    """The values without slopes."""
    return values.values if isinstance(values, Dual) else values


def _call_without_slopes(what: str, function: Callable, given: Any, options: dict) -> Any:
    """What a function gives that takes plain numbers alone; LostSlopesError if any has slopes."""
    if (error := LostSlopesError(what, given)).numbers:
        raise error
    lists = [
        [*map(without_slopes, one)] if type(one) is list else without_slopes(one) for one in given
    ]
    return function(*lists, **options)


def with_slopes(values: Any, count: int) -> Dual:
    """Numbers with slopes by `count` others; zero where they have none."""
    dual = as_dual_array(values)
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


def _in_scene(of_dual: Callable) -> Callable:
    def result(self, other):
        if not isinstance(other, float | int | np.ndarray):
            return NotImplemented
        return scene_number(of_dual(Dual(self, self.slopes), other))

    return result


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _text in (f"__{_name}__", f"__r{_name}__"):
        setattr(DualFloat, _text, _in_scene(getattr(Dual, _text)))


def _slope(function: Callable) -> Callable:
    """The derivative of an analytic function of one argument."""
    return lambda o, a: function(a + _STEP * 1j).imag / _STEP


#: The derivative of a sum by its parts, with which slopes need not be multiplied.
_ONE = 1.0
#: Derivatives of functions by each argument, of the result and the arguments.
_RULES: dict[Any, tuple[Callable[..., Any], ...]] = {
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
_OF_VALUES = {
    *(np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
    *(np.isfinite, np.isnan, np.isinf, np.floor, np.ceil, np.sign, np.floor_divide),
    *(np.shape, np.ndim, np.size, np.zeros_like, np.ones_like, np.empty_like, np.full_like),
    *(np.any, np.all, np.array_equal, np.searchsorted, np.argsort, np.argmax, np.argmin),
    np.iscomplexobj,
}


def _matmul(a: tuple, b: tuple) -> Dual:
    (A, by_a), (B, by_b) = a, b
    total = np.zeros(())
    if by_a is not None:
        of_a = B.T @ by_a if B.ndim < 3 else np.moveaxis(np.moveaxis(by_a, -1, 0) @ B, 0, -1)
        total = total + of_a
    if by_b is not None:
        of_b = A @ by_b if B.ndim == 1 else np.moveaxis(A @ np.moveaxis(by_b, -1, 0), 0, -1)
        total = total + of_b
    return Dual(A @ B, total)


def _along(function: Callable) -> Callable:
    """A linear function of the values along an axis, or of all."""

    def result(a, axis=None, **options) -> Dual:
        a, axis = (a, axis % a.ndim) if axis is not None else (a.reshape(-1), 0)
        return Dual(*(function(of, axis=axis, **options) for of in (a.values, a.slopes)))

    return result


_sum = _along(np.sum)


def _interp(x, xp, fp) -> Any:
    """Interpolated on a line between points; its slopes at a point are those after it."""
    x, xp, fp = map(as_dual_array, (x, xp, fp))
    at, points = without_slopes(x), without_slopes(xp)
    if len(points) == 1:
        return fp[np.zeros(np.shape(at), int)]
    i = np.searchsorted(points[1:-1], at, "right")
    w = _clip((x - xp[i]) / (xp[i + 1] - xp[i]), 0.0, 1.0)
    if isinstance(w, Dual) or not isinstance(fp, Dual):
        return fp[i] + w * (fp[1:] - fp[:-1])[i]
    before, slopes = fp.slopes.take(i, 0), fp.slopes.take(i + 1, 0)
    slopes -= before  # in place, as there may be many
    slopes *= w[..., None]
    slopes += before
    return Dual(np.interp(at, points, fp.values), slopes)


def _clip(a, low=None, high=None) -> Any:
    a = a if low is None else np.maximum(a, low)
    return a if high is None else np.minimum(a, high)


def _linspace(start, stop, num=50, endpoint=True):
    fractions = np.linspace(0.0, 1.0, num, endpoint)
    start, stop = as_dual_array(start), as_dual_array(stop)
    return start + fractions.reshape(-1, *[1] * np.ndim(start)) * (stop - start)


def _broadcast_to(a, shape) -> Dual:
    if a.values.shape == shape:
        return a
    values = np.broadcast_to(a.values, shape)
    return Dual(values, np.broadcast_to(a.slopes, (*values.shape, a.slopes.shape[-1])))


def _bincount(at, weights, size):
    count = weights.slopes.shape[-1]
    places = (at[:, None] * count + np.arange(count)).ravel()
    slopes = np.bincount(places, weights.slopes.ravel(), size * count).reshape(size, count)
    return Dual(np.bincount(at, weights.values, size), slopes)


def _joined(function: Callable, arrays: Any, axis: int = 0) -> Dual:
    """Arrays side by side, without numbers of their entries, as there may be many."""
    count = next(of.slopes.shape[-1] for of in map(dual_of, arrays) if of is not None)
    duals = [with_slopes(of, count) for of in arrays]
    values = function([of.values for of in duals], axis)
    return Dual(values, function([of.slopes for of in duals], axis % values.ndim))


def _norm(a: Any, ord: Any = None, axis: Any = None) -> Any:  # noqa: A002  # as NumPy's
    if ord is not None:
        return _call_without_slopes(f"numpy.linalg.norm of order {ord}", np.linalg.norm, (a,), {})
    return np.sqrt(_sum(a * a, axis))


_FUNCTIONS: dict[Any, Callable] = {
    np.sum: _sum,
    np.mean: _along(np.mean),
    np.cumsum: _along(np.cumsum),
    np.diff: lambda a, n=1, axis=-1: _along(functools.partial(np.diff, n=n))(a, axis),
    np.dot: lambda a, b: np.matmul(a, b) if np.ndim(a) and np.ndim(b) else a * b,
    np.outer: lambda a, b: as_dual_array(a).reshape(-1)[:, None] * as_dual_array(b).reshape(-1),
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
#: Functions that only place entries, and which arguments have these.
_PLACING = dict.fromkeys(
    (np.hstack, np.vstack, np.column_stack, np.dstack, np.reshape)
    + (np.ravel, np.transpose, np.atleast_1d, np.atleast_2d, np.copy, np.repeat, np.tile, np.flip)
    + (np.roll, np.squeeze, np.expand_dims, np.swapaxes, np.moveaxis, np.take, np.diag),
    (0,),
) | {np.where: (1, 2), np.append: (0, 1)}


def _placed(function: Callable, given: Any, options: dict) -> Dual:
    """What a function that only places entries gives: it places values, then rows of slopes."""
    parts, count = list[np.ndarray](), 1

    def values_and_rows(value: Any) -> tuple[Any, Any]:
        nonlocal count
        if isinstance(value, list | tuple):
            pairs = [values_and_rows(part) for part in value]
            return [values for values, _ in pairs], [rows for _, rows in pairs]
        if (dual := dual_of(value)) is None:
            return value, np.zeros(np.shape(value), int)  # row 0 has no slopes
        parts.append(dual.slopes.reshape(-1, dual.slopes.shape[-1]))
        first, count = count, count + len(parts[-1])
        return dual.values, np.arange(first, count).reshape(dual.shape)

    of = _PLACING[function]
    pairs = [
        values_and_rows(one) if i in of else (without_slopes(one),) * 2
        for i, one in enumerate(given)
    ]
    values, rows = (function(*arguments, **options) for arguments in zip(*pairs, strict=True))
    slopes = np.concatenate([np.zeros((1, parts[0].shape[1])), *parts])
    return Dual(values, slopes.take(rows, 0))


_METHODS = {of.__name__: of for of in _RULES if of.nin == 1}
_METHODS |= {of.__name__: of for of in (np.sum, np.mean, np.cumsum, np.dot, np.clip, np.repeat)}
_METHODS |= {of.__name__: of for of in (np.ravel, np.transpose, np.copy, np.squeeze, np.argsort)}
_METHODS |= {"max": np.max, "min": np.min, "flatten": np.ravel}
