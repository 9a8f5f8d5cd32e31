"""All use of FFCx, and of the C that it generates, whose versions differ."""

from __future__ import annotations

import inspect
import logging
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from fx_beam.symbolic import Written, package, ufl

# Before parts of FFCx, which import UFL as well.
package("ufl")
ffcx: Any = package("ffcx")

from ffcx import codegeneration, naming  # noqa: E402
from ffcx.analysis import analyze_ufl_objects  # noqa: E402
from ffcx.codegeneration.codegeneration import generate_code  # noqa: E402
from ffcx.ir.representation import compute_ir  # noqa: E402

_log = logging.getLogger("fx_beam")
#: All of every version, which would else look for more in the current folder and in the home.
OPTIONS = {
    "scalar_type": "double" if find_spec("ffcx.parameters") else "float64",
    **{"epsilon": 1e-14, "table_rtol": 1e-6, "table_atol": 1e-9, "verbosity": logging.WARNING},
    # Up to 0.6, and of later versions.
    **{"tabulate_tensor_void": False, "assume_aligned": -1, "padlen": 1},
    **{"sum_factorization": False, "language": "C", "part": "full"},
}
_ANALYSIS_OPTIONS: Any = OPTIONS
if "parameters" not in inspect.signature(analyze_ufl_objects).parameters:
    _ANALYSIS_OPTIONS = OPTIONS["scalar_type"]
_HEADERS = "math.h", "stdalign.h", "stdlib.h", "string.h"
# Generated code with functions of one element; the first two are what version 0.5 refers to in it.
_BLOCKS = "elements", "dofmaps", "integrals", "expressions"
if find_spec("ffcx.parameters"):  # 0.5 refuses to compare Gauss rules of different lengths
    from ffcx.element_interface import QuadratureElement

    QuadratureElement.__eq__ = lambda a, b: repr(a) == repr(b)
_FUNCTION = re.compile(r"void (tabulate_tensor_\w+)\(([^)]*)\)")


def signature(written: Written) -> str:
    """Identifier of forms, with all that is written of them."""
    forms = [*written.forms.values()]
    symbols = (symbol for form in forms for group in _symbols(form) for symbol in group)
    tag = repr(([*written.forms], [written.names[symbol] for symbol in symbols], written.facts))
    return naming.compute_signature(forms, tag) if forms else tag


def generated(written: Written, prefix: str) -> dict[str, Any]:
    """C of functions of one element, and what must be known of it, as `FormModule` has them.

    Names in C begin with the prefix.
    """
    for name in written.forms:
        _log.info("compiled the form %r, once", name)
    if not written.forms:
        return {"header": "", "source": "", "arguments": 0, "forms": {}, "facts": written.facts}
    with _quiet():
        analysis = analyze_ufl_objects([*written.forms.values()], _ANALYSIS_OPTIONS)
        ir = compute_ir(analysis, {}, prefix, OPTIONS, False)
        code: Any = generate_code(ir, OPTIONS)
    code = code if hasattr(code, "integrals") else code[0]  # later versions add suffixes of files
    parts = [part for block in _BLOCKS for part in getattr(code, block, [])]
    folder = codegeneration.get_include_path()
    header = "".join(f"#include <{name}>\n" for name in _HEADERS) + f'#include "{folder}/ufcx.h"\n'
    # Equal expressions have one name, and other aliases only.
    texts = {(_FUNCTION.search(text) or [text])[0]: text for _, text in parts}
    source = "\n".join([*(declared for declared, _ in parts), *texts.values()])
    functions = dict(_FUNCTION.findall(source))
    pairs = zip(written.forms.items(), ir.forms or ir.expressions, strict=True)
    return {
        "header": header,
        "source": source,
        "arguments": next((parameters.count(",") + 1 for parameters in functions.values()), 0),
        "forms": {
            name: _described(form, p, written.names, [*functions]) for (name, form), p in pairs
        },
        "facts": written.facts,
    }


def _described(
    form: Any, ir: Any, names: Mapping[Any, str], functions: list[str]
) -> dict[str, Any]:
    """Members of `CompiledForm` of a form or expression."""
    coefficients, constants = _symbols(form)
    plural = "original_coefficient_position" + "s" * hasattr(ir, "original_coefficient_positions")
    if isinstance(form, ufl.Form):
        arguments, values = len(form.arguments()), 0
        pairs = [*zip(ir.subdomain_ids["cell"], ir.integral_names["cell"], strict=True)]
    else:
        arguments, values = 0, math.prod(form[0].ufl_shape)
        pairs = [(-1, getattr(ir, "expression", ir).name)]
    return {
        "coefficients": [names[coefficients[i]] for i in getattr(ir, plural)],
        "constants": [names[symbol] for symbol in constants],
        "arguments": arguments,
        "values": values,
        # Later versions add the kind of cell to the name of an integral.
        "functions": sorted(
            (tag, next(f for f in functions if f.startswith(f"tabulate_tensor_{name}")))
            for tag, name in pairs
        ),
    }


def _symbols(form: Any) -> tuple[list[Any], list[Any]]:
    """UFL's coefficients and constants of a form, or of an expression with its points."""
    if isinstance(form, ufl.Form):
        return form.coefficients(), form.constants()
    analysis = ufl.algorithms.analysis
    return analysis.extract_coefficients(form[0]), analysis.extract_constants(form[0])


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the compiler's lines out of the user's log."""
    loggers = logging.getLogger("ffcx"), logging.getLogger("UFL")
    for logger in loggers:
        logger.addFilter(_is_warning)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(_is_warning)


def _is_warning(record: logging.LogRecord) -> bool:
    return record.levelno > logging.INFO
