"""Formulas that schemes write themselves: `<!-- written: MidPoint -->` on a page is their place."""

import re

import fx_beam

PLACE = re.compile(r"<!-- written: (\w+) -->")


def formulas(text):
    """The text of a page with the formulas in their places."""
    return PLACE.sub(lambda place: getattr(fx_beam, place[1])().written("latex"), text)


def setup(app):
    """Connect to Sphinx."""

    def write(app, page, text):
        text[0] = formulas(text[0])

    app.connect("source-read", write)
    return {"parallel_read_safe": True}
