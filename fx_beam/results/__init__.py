"""Results of an analysis: the solution, its energies and momenta, and files of them.

Plain data; a saved solution is read without a mesh.
"""
