"""Studies that compare time schemes: error against run time, and stability.

They use the public interface of the package only, as a user's own study would.
"""
