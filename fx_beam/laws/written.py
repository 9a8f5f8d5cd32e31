"""The weak form of a step as on paper: its functions, called with named symbols."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

from fx_beam.errors import is_one_of, require
from fx_beam.scene.law import Law
from fx_beam.scene.ufl_symbols import STEP, Symbol
from fx_beam.symbolic import Expr, parts_of, ufl

from .kinematics import director, perp, strains, tan, turn_of
from .rates import NodalRates, UpdateRule
from .resultants import WeightedResultants, x_over_tan

_GREEK = "alpha gamma delta epsilon kappa rho phi psi omega".split()
_LETTERS = {name: unicodedata.lookup(f"GREEK SMALL LETTER {name}") for name in _GREEK}
_LETTERS |= {"Delta": "\u0394", "lambda": "\u03bb"}
_LOW = str.maketrans(
    "0123456789-mi", "".join(map(chr, range(0x2080, 0x208A))) + "\u208b\u2098\u1d62"
)
_SIGNS = {"LT": "<", "GT": ">", "LE": "<=", "GE": ">=", "EQ": "==", "NE": "!="}
_SIGNS |= {"AndCondition": "and", "OrCondition": "or"}
# Names on paper of the fields of a step; the reference tangent is X', and t a director.
_NAMES = {
    **{"u0": "u_0", "psi0": "psi_0", "Du": "Delta_u", "Dpsi": "Delta_psi", "u": "u", "psi": "psi"},
    **{"v": "v", "omega": "omega", "virtual_u": "delta_u", "virtual_psi": "delta_psi", "X": "X"},
    **{"t0": "X'", "h": "h", "t": "time", "dt": "Delta_t", "load_factor": "lambda", "memory": "r"},
    **{"u_before": "u_-", "psi_before": "psi_-", "natural0": "natural_0", "natural1": "natural_1"},
    **{"director": "t", "director0": "t_0", "director1": "t_1"},
}
# Those of strains, with the name of each in the place of a star.
_STRAINS = {"total_strains0": "*_0", "total_strains1": "*_1", "strains_before": "*_-"}
_STRAINS |= {"strains0": "*_0", "strains1": "*_1", "strain_increments": "Delta_*"}
_STRAIN = "epsilon", "gamma", "kappa"
_RESULTANTS = {"dphi": "phi'", "t": "t", "N": "N", "Q": "Q", "M": "M", "m": "m"}
_VECTORS, _STIFFNESS = ("dphi", "t"), ("EA", "GA", "EI")
# How strongly parts of a text hold together.
_SUM, _QUOTIENT, _PRODUCT, _POWER, _ATOM = range(5)


class Formulas(str):
    """Formulas in lines; a notebook shows those in LaTeX as such."""

    def _repr_latex_(self) -> str | None:
        return f"{self}" if self.startswith("$$") else None


class _Call(NamedTuple):
    """The value of a function at some arguments, as a name."""

    function: str
    arguments: tuple[Expr, ...]


@dataclass(frozen=True)
class _LawOnPaper(Law):
    """A law whose energy W and derivatives are symbols, or of linear elasticity."""

    paper: Any = None

    def resultants(self, *strains: Expr) -> tuple[Expr, ...]:
        """EA eps, GA gamma and EI kappa, or the derivatives of W."""
        paper = self.paper
        if self.quadratic:
            return tuple(paper.symbol(C) * e for C, e in zip(_STIFFNESS, strains, strict=True))
        return tuple(paper.symbol(_Call(f"W_{e}", strains)) for e in _STRAIN)

    linear = lambda self, strains: self.resultants(*strains)  # noqa: E731


class Paper:
    """Names of symbols and expressions, and lines of formulas with these."""

    def __init__(self) -> None:
        self._step: Any = copy(STEP)
        self._step.natural0 = self._step.natural1 = None
        #: Names of symbols, and of expressions by their text.
        self.names: dict[Expr, str | _Call] = {}
        self.short: dict[str, str | Expr] = {}
        self._symbols: dict[str | _Call, Expr] = {}
        self.name_step(STEP)
        #: Left and right sides.
        self.lines: list[tuple[str, Expr]] = []
        #: Half the difference of nodal half increments of rotation in an element of two nodes.
        self._d = STEP.h * STEP.prime(STEP.Dpsi) / 4
        d = self.symbol("d")
        self._shorten({self._d: "d", x_over_tan(self._d, tan(self._d)): d * self._call("cot", d)})

    def symbol(self, name: str | _Call, *shape: int) -> Expr:
        """The symbol of a name."""
        if name not in self._symbols:
            self._symbols[name] = symbol = Symbol(*shape)
            self.names[symbol] = name
        return self._symbols[name]

    def _call(self, function: str, *arguments: Expr) -> Expr:
        return self.symbol(_Call(function, arguments))

    def _shorten(self, names: Mapping[Expr, str | Expr]) -> None:
        plain = Writer(self.names, {})
        self.short |= {plain.text(expression): name for expression, name in names.items()}

    def name_step(self, step: Any) -> None:
        """Name the fields of a step, and what follows from its start, middle and end."""
        for field, name in _STRAINS.items():
            pairs = zip(getattr(step, field), _STRAIN, strict=True)
            self.names |= {strain: name.replace("*", letter) for strain, letter in pairs}
        fields = {getattr(step, field): name for field, name in _NAMES.items()}
        fields.pop(None, None)
        for vector in [x for x in fields if getattr(x, "ufl_shape", ()) == (2,)]:
            fields |= {vector[i]: f"{fields[vector]}[{i}]" for i in range(2)}
        self.names |= fields
        ends = {"_0": (step.u0, step.psi0), "_1": (step.u0 + step.Du, step.psi0 + step.Dpsi)}
        ends["_m"] = step.u0 + step.Du / 2, step.psi0 + step.Dpsi / 2
        for index, (u, psi) in ends.items():
            du, turn = step.prime(u), turn_of(step.t0, psi)
            named = {u: "u", psi: "psi", step.t0 + turn: "t", director(psi, step.t0): "t"}
            values = strains(du, step.t0 + turn, turn, step.prime(psi))
            named |= {step.t0 + du: "phi'"} | dict(zip(values, _STRAIN, strict=True))
            self._shorten({e: _indexed(name, index) for e, name in named.items()})

    def define(self) -> None:
        """Add the director and the strains of a configuration i."""
        psi, turn = self.symbol("psi_i"), self.symbol("psi_i'")
        dphi, t = self.symbol("phi_i'", 2), self.symbol("t_i", 2)
        self.lines.append(("t_i", director(psi, STEP.t0)))
        values = strains(dphi, t, t, turn)  # E = phi' - t
        self.lines += zip((f"{name}_i" for name in _STRAIN), values, strict=True)

    def add(self, resultants: Callable[[Any, Law], Any], quadratic: bool = True) -> None:
        """Add resultants of a step, and their virtual work."""
        law = _LawOnPaper(lambda *e: self._call("W", *e), quadratic, paper=self)
        r = resultants(self._step, law)
        if not isinstance(r, WeightedResultants):
            self.lines.append(("delta_W", self._work(r, "")))
            return
        ends = [(1 - r.level, r.start, "_0"), (r.level, r.end, "_1")]
        works = [share * self._work(end, index) for share, end, index in ends if share]
        self.lines.append(("delta_W", sum(works[1:], works[0])))

    def _work(self, r: Any, index: str) -> Expr:
        """Add the lines of resultants; their virtual work, of symbols."""
        named = {field: _indexed(name, index) for field, name in _RESULTANTS.items()}
        self.lines += [(name, getattr(r, field)) for field, name in named.items()]
        symbols = type(r)(*(self.symbol(n, *[2] * (f in _VECTORS)) for f, n in named.items()))
        self.lines.append((f"n{index}", symbols.n))
        self._shorten({symbols.n: f"n{index}"})
        work = symbols.virtual_work(self._step)
        if self._d in parts_of(work):
            self.lines.append(("d", ufl.as_ufl(1) * self._d))
        return work

    def add_inertia(self, rates: UpdateRule) -> None:
        """Add the acceleration of displacements in the equation of motion."""
        D, v, a, before = (self.symbol(name, 3) for name in ("D", "v_0", "a_0", "D_-"))
        if isinstance(rates, NodalRates):
            value = rates.values(rates.rules[0], D, v, a, before, STEP.dt)[0]
        elif not rates.at_rest:
            value = rates.acceleration(D, v, a, STEP.dt)[0]
        else:
            return
        self.lines.append(("a", value))

    def in_style(self, style: str) -> Formulas:
        """The lines as text, unicode or latex."""
        require(is_one_of(style, tuple(_STYLES)), "written: format", style, f"one of {[*_STYLES]}")
        writer = _STYLES[style](self.names, self.short)
        lines = [(writer.name(left), writer.definition(left, right)) for left, right in self.lines]
        lines = [(left, right) for left, right in lines if left != right]
        if style == "latex":
            rows = (r" \\" + "\n").join(f"{left} &= {right}" for left, right in lines)
            return Formulas(f"$$\n\\begin{{aligned}}\n{rows}\n\\end{{aligned}}\n$$")
        width = max(len(left) for left, _ in lines)
        return Formulas("\n".join(f"{left:{width}} = {right}" for left, right in lines))


class Writer:
    """Writes expressions in UFL as text, with names of symbols."""

    dot, times, quarter_turn, power = ".", " ", "W ", "^{}"

    def __init__(self, names: Mapping[Expr, str | _Call], short: Mapping[str, str | Expr]):
        self._names, self._short = names, short
        self._plain = Writer(names, {}) if short else self

    def name(self, name: str) -> str:
        """A name on paper such as "Delta_psi" or "phi_0'"."""
        return name

    def text(self, o: Expr, least: int = _SUM) -> str:
        """An expression, in brackets if it holds together less than this."""
        text, strength = self._written(o)
        return self.brackets(text) if strength < least else text

    def definition(self, name: str, o: Expr) -> str:
        """An expression of which a name is the short form, if the name is the paper's own."""
        own = self._short.get(self._plain.text(o)) == name and name[0] in "nd"
        return self._parts_of(o)[0] if own else self.text(o)

    def brackets(self, text: str) -> str:
        """A text in brackets."""
        return f"({text})"

    def quotient(self, a: Expr, b: Expr) -> tuple[str, int]:
        """A quotient."""
        return f"{self.text(a, _QUOTIENT)}/{self.text(b, _POWER)}", _QUOTIENT

    def cases(self, condition: str, a: str, b: str) -> tuple[str, int]:
        """One of two texts."""
        return f"({a} if {condition} else {b})", _ATOM

    def function(self, name: str, arguments: Iterable[Expr]) -> tuple[str, int]:
        """A function of arguments."""
        return f"{self.name(name)}({', '.join(map(self.text, arguments))})", _ATOM

    def _written(self, o: Expr) -> tuple[str, int]:
        """An expression as text, and how strongly it holds together."""
        if o in self._names:
            name = self._names[o]
            return self.function(*name) if isinstance(name, _Call) else (self.name(name), _ATOM)
        if self._short and (short := self._short.get(self._plain.text(o))) is not None:
            return (self.name(short), _ATOM) if isinstance(short, str) else self._written(short)
        return self._parts_of(o)

    def _parts_of(self, o: Expr) -> tuple[str, int]:
        types, x = ufl.classes, o.ufl_operands
        if (base := _turned(o)) is not None:
            return self.quarter_turn + self.text(base, _POWER), _PRODUCT
        if isinstance(o, types.ScalarValue):
            return f"{float(o):.6g}", _ATOM if float(o) >= 0 else _SUM
        if isinstance(o, types.Zero):
            return "0", _ATOM
        if isinstance(o, types.Sum):
            a, b = sorted(map(self.text, x), key=lambda text: text.startswith("-"))
            return (f"{a} - {b[1:]}" if b.startswith("-") else f"{a} + {b}"), _SUM
        if isinstance(o, types.Product):
            if (minus := [i for i in (0, 1) if x[i] == -1]) != []:
                return f"-{self.text(x[1 - minus[0]], _QUOTIENT)}", _SUM
            a, b = sorted(x, key=lambda factor: isinstance(factor, types.Indexed | types.Dot))
            if isinstance(b, types.Division) and not _is_tangent(b):
                return self.quotient(a * b.ufl_operands[0], b.ufl_operands[1])
            return self.times.join(self.text(factor, _PRODUCT) for factor in (a, b)), _PRODUCT
        if isinstance(o, types.Division):
            return self.function("tan", x[0].ufl_operands) if _is_tangent(o) else self.quotient(*x)
        if isinstance(o, types.Power):
            return self.text(x[0], _ATOM) + self.power.format(self.text(x[1], _ATOM)), _POWER
        if isinstance(o, types.Dot) and isinstance(x[0], types.Grad):
            return f"{self.text(x[0].ufl_operands[0], _ATOM)}'", _ATOM
        if isinstance(o, types.Dot | types.Inner):
            return f"{self.text(x[0], _PRODUCT)} {self.dot} {self.text(x[1], _PRODUCT)}", _PRODUCT
        if isinstance(o, types.ComponentTensor | types.Variable):
            return self._written(x[0])
        if isinstance(o, types.Indexed):
            index = x[1][0]
            if not isinstance(index, types.FixedIndex):
                return self._written(x[0])
            return f"{self.text(x[0], _ATOM)}[{int(index)}]", _ATOM
        if isinstance(o, types.Conditional):
            return self.cases(*map(self.text, x))
        if isinstance(o, types.BinaryCondition):
            return f"{self.text(x[0])} {_SIGNS[type(o).__name__]} {self.text(x[1])}", _SUM
        if isinstance(o, types.Abs):
            return f"|{self.text(x[0])}|", _ATOM
        if isinstance(o, types.CoefficientDerivative):
            return self.function("derivative", x[:1])
        if isinstance(o, types.ListTensor):
            return self.brackets(", ".join(map(self.text, x))), _ATOM
        if isinstance(o, types.Terminal):
            if not (name := getattr(o, "name", "")) and hasattr(o, "value") and o.ufl_shape == ():
                return self._parts_of(ufl.as_ufl(float(o.value)))  # of a Constant of dolfinx
            return self.name(name or str(o)), _ATOM
        return self.function(type(o).__name__.lower().removesuffix("value"), x)


class UnicodeWriter(Writer):
    """Writes Greek letters and low indices."""

    dot, quarter_turn = "\u00b7", "W"

    def name(self, name: str) -> str:
        """A name on paper."""
        prefix, base, index, primes = _parts(name)
        letters = _LETTERS.get(prefix, prefix) + _LETTERS.get(base, base)
        index = f",{_LETTERS[index]}" if index in _LETTERS else index.translate(_LOW)
        return letters + index + primes


class LatexWriter(Writer):
    """Writes LaTeX."""

    dot, times, power = r"\cdot", r" \, ", "^{{{}}}"

    def name(self, name: str) -> str:
        """A name on paper."""
        prefix, base, index, primes = _parts(name)
        if base in _LETTERS or base in ("sin", "cos", "tan", "sqrt", "exp"):
            base = f"\\{base} "
        elif len(base) > 2 or "_" in base:
            base = rf"\mathrm{{{base}}}".replace("_", r"\_")
        index = f",\\{index}" if index in _LETTERS else index
        prefix, index = prefix and f"\\{prefix} ", index and f"_{{{index}}}"
        return f"{prefix}{base.strip()}{index}{primes}"

    def brackets(self, text: str) -> str:
        """A text in brackets that grow with it."""
        return rf"\left({text}\right)"

    def quotient(self, a: Expr, b: Expr) -> tuple[str, int]:
        """A fraction."""
        return rf"\frac{{{self.text(a)}}}{{{self.text(b)}}}", _PRODUCT

    def cases(self, condition: str, a: str, b: str) -> tuple[str, int]:
        """Cases in a bracket."""
        rows = rf"{a} & {condition} \\ {b} & \text{{else}}"
        return rf"\begin{{cases}} {rows} \end{{cases}}", _ATOM

    def function(self, name: str, arguments: Iterable[Expr]) -> tuple[str, int]:
        """A function of arguments."""
        return self.name(name) + self.brackets(", ".join(map(self.text, arguments))), _ATOM


_STYLES = {"text": Writer, "unicode": UnicodeWriter, "latex": LatexWriter}


def _parts(name: str) -> tuple[str, ...]:
    """Prefix, name, index and primes of a name on paper."""
    pattern = r"(?:(delta|Delta)_)?(.+?)(?:_([-\dmi]|epsilon|gamma|kappa))?('*(?:\[\d\])?)"
    (parts,) = re.findall(f"^{pattern}$", name)
    return tuple(parts)


def _indexed(name: str, index: str) -> str:
    return f"{name.rstrip(chr(39))}{index}" + "'" * name.endswith("'")


def _is_tangent(o: Expr) -> bool:
    a, b = o.ufl_operands
    return isinstance(a, ufl.classes.Sin) and isinstance(b, ufl.classes.Cos)


def _turned(o: Expr) -> Expr | None:
    """The vector a of W a = (-a[1], a[0])."""
    if isinstance(o, ufl.classes.ListTensor) and o.ufl_shape == (2,):
        last = o.ufl_operands[1]
        if isinstance(last, ufl.classes.Indexed) and perp(last.ufl_operands[0]) == o:
            return last.ufl_operands[0]
    return None
