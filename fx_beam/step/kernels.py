"""C functions of one element, from the functions that FFCx generates for each form."""

from __future__ import annotations

from typing import NamedTuple

from fx_beam.fem import ffcx_api
from fx_beam.fem.assembly import BoundForm


class Kernel(NamedTuple):
    """Forms that are evaluated together, such as internal forces and their tangent.

    The compiler evaluates only once what they have in common, such as sines and cosines.
    """

    #: Forms on a mesh; their tensor entries are in this order. The first has all coefficients and
    #: constants.
    forms: list[BoundForm]

    @property
    def size(self) -> int:
        """Number of all tensor entries."""
        return sum(form.size for form in self.forms)

    @property
    def key(self) -> str:
        """Identifier of the generated code."""
        return "".join(ffcx_api.signature(form.compiled) for form in self.forms)

    def source(self) -> str:
        """C functions element_0, element_1, ... for each integral."""
        tags = ffcx_api.integrals(self.forms[0].compiled)
        bodies: dict[int, list[str]] = {tag: [] for tag in tags}
        declared, texts = [], []
        for number, compiled in enumerate(form.compiled for form in self.forms):
            text, names, parameters = ffcx_api.element_functions(compiled)
            texts.append(text)
            declared += [f"INLINED ufcx_tabulate_tensor_float64 {name};" for name in names]
            unused = ", 0" * (parameters - 4)
            for tag, name in zip(ffcx_api.integrals(compiled), names, strict=True):
                bodies[tag].append(self._call(number, name, unused))
        arguments = "double *A, const double *w, const double *c, const double *x"
        elements = [
            f"INLINED void element_{i}({arguments}) {{\n{''.join(bodies[tag])}}}"
            for i, tag in enumerate(tags)
        ]
        # Forms of one module have the same text.
        texts = list(dict.fromkeys(texts))
        return "\n".join([*declared, "#define for UNROLLED for", *texts, *elements, "#undef for"])

    def _call(self, number: int, name: str, unused: str) -> str:
        """Call of the function of a form with its own coefficients and constants."""
        if number == 0:
            return f"{name}(A, w, c, x{unused});\n"
        first = sum(form.size for form in self.forms[:number])
        indices = self.forms[number].indices_in(self.forms[0])
        lists = (
            ", ".join(f"{array}[{i}]" for i in of_own) or "0"
            for array, of_own in zip("wc", indices, strict=True)
        )
        packed = "double own_w[] = {{{}}}, own_c[] = {{{}}}".format(*lists)
        return f"{{ {packed};\n{name}(A + {first}, own_w, own_c, x{unused}); }}\n"
