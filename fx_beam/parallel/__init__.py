"""One large scene on the processes of mpirun, without a change of the script.

Frames of 10^4 struts and more, which one process steps too slowly or has no memory for: each
process evaluates its part of the elements, joints and loads, and PETSc solves for all. The first
process has the whole scene, runs the script, takes the steps and makes the solution; it sends its
parts to the others, which answer until it ends. For terms, solvers and meshes of one's own there is
the room `fenicsx`, which is slower: 0.75 s a step of a frame that takes 0.11 s here, on two
processes.
"""
