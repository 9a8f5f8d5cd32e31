"""The model: a scene and a scheme as compiled forms, matrices, unknowns and equations.

Time steps, load steps and modal analysis use only this model.
"""
