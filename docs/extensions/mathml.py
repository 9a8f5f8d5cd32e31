"""Formulas as MathML, which browsers draw by themselves, with the font of the site: no script.

Of what Sphinx has, `sphinx.ext.mathjax` loads a script from another site and `sphinx.ext.imgmath`
needs LaTeX. docutils makes MathML of LaTeX, but Sphinx does not call it.
"""

import re

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

# Signs without space around them; angle brackets of one size, a prime in place of an apostrophe, a
# macron that the font has.
_CLOSE = {
    '<mo stretchy="false">/</mo>': '<mo stretchy="false" lspace="0" rspace="0">/</mo>',
    '<mo stretchy="false">|</mo>': '<mo stretchy="false" lspace="0" rspace="0">|</mo>',
    "<mo>⟨</mo>": '<mo stretchy="false">⟨</mo>',
    "<mo>⟩</mo>": '<mo stretchy="false">⟩</mo>',
    "<mo>max</mo>": "<mi>max</mi>",
    "<mo>'</mo>": '<mo lspace="0" rspace="0">′</mo>',
    "ˉ": "¯",
}

# Browsers set no space at the name of a function: a thin one before it, and one after it unless an
# argument in brackets or an exponent follows.
_FUNCTION = re.compile(
    r"<mi>((?:sin|cos|tan|exp|ln|log|sgn)h?)</mi>(\s*<mo>&ApplyFunction;</mo>)?(\s*<mo[^>]*>\()?"
)
# docutils puts the index of an accented symbol below it.
_INDEX = re.compile(
    r"<munderover>\s*(<mi>[^<]*</mi>)\s*(.*?)\s*(<mo[^>]*>[¯ˆ˙¨˜]</mo>)\s*</munderover>", re.DOTALL
)
# A minus after these is that of a number.
_MINUS = re.compile(r"((?:⟨|&lt;|,)</mo>\s*)<mo>−</mo>")
_THIN = '<mspace width="0.1667em"/>'


def _spaced(match):
    name, applied, bracket = match.groups()
    after = bracket or (_THIN if applied else "")
    # A row is one thing, also as the base of an exponent.
    return f"<mrow>{_THIN}<mi>{name}</mi></mrow>{after}"


def mathml(formula, as_block):
    """A formula in LaTeX as MathML."""
    text = tex2mathml(formula, as_block=as_block)
    for latex, better in _CLOSE.items():
        text = text.replace(latex, better)
    text = _INDEX.sub(r'<msub><mover accent="true">\1\3</mover>\2</msub>', text)
    text = _MINUS.sub(r'\1<mo form="prefix">−</mo>', text)
    return _FUNCTION.sub(_spaced, text)


def inline(formula):
    """A formula within a line."""
    return mathml(formula, as_block=False)


def block(formula):
    """A formula on a line of its own."""
    return f'<div class="formula">{mathml(formula, as_block=True)}</div>'


def _visitor(draw):
    def visit(self, node):
        self.body.append(draw(node.astext()))
        raise SkipNode

    return visit


def setup(app):
    """Register the renderer under the name that conf.py asks for."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(_visitor(inline), None), block_renderers=(_visitor(block), None)
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
