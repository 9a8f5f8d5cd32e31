"""What users call: `simulate`, `static` and `modes`.

Each builds a model, runs it and returns a solution.
"""
