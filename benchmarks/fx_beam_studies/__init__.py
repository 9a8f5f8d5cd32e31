"""Studies that compare time schemes: error against run time, and stability.

They build on `fx_beam`, which does not know them.
"""
