"""Motions: `simulate` and `Motion`, their start, their end, and scenes that change on the way."""
