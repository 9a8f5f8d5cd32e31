"""Shared set-up: the tests' own helpers can be imported, and hypothesis knows no deadline."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

# The first example of a run compiles forms, which is no reason to fail.
settings.register_profile("fx_beam", deadline=None, max_examples=25)
settings.load_profile("fx_beam")
